"""A needle that snaps is seen in the data alone; one that only resists never looks like it."""

import dataclasses

import numpy as np
import pytest

from needle_rig.dataset import Dataset
from needle_rig.physics.library import find_effects
from needle_rig.units import rad
from needle_rig.workbench.observations.snaps import sentence, snaps
from tests.workbench.hidden import dataset, effect

FALLING = ("stribeck", "stiction_ageing", "bending_torque")
"""Whose resistance falls with the rate, the slip or the angle."""
RESISTING = sorted(set(find_effects()) - {*FALLING, "coupling_slip"})


def snapping() -> Dataset:
    return dataset(effect("stribeck", static_excess=1.0, rate_deg_s=11.5, weakening_deg=0.8))


def test_a_needle_that_snaps_is_seen_with_place_and_size() -> None:
    found = snaps(snapping())
    assert found
    assert abs(found[0].turned_deg) > 1.25 * found[0].base_deg
    assert [abs(s.turned_deg) for s in found] == sorted((abs(s.turned_deg) for s in found), reverse=True)
    told = sentence(found)
    assert found[0].file in told
    assert found[0].sensor in told
    assert "stick-slip" in told


@pytest.mark.parametrize("name", RESISTING)
def test_no_effect_that_only_resists_looks_like_a_snap(name: str) -> None:
    # a neighbour's field can be no larger than the magnet's own
    strength = 2.0 if name == "hall_crosstalk" else 3.0
    assert snaps(dataset(find_effects()[name].at_strength(strength), seed=5)) == ()


@pytest.mark.parametrize("seed", range(1, 6))
def test_nothing_hidden_is_no_snap(seed: int) -> None:
    found = snaps(dataset(seed=seed))
    assert found == ()
    assert sentence(found) == ""


def test_a_wild_sample_or_a_missing_one_is_no_snap() -> None:
    plain = dataset()
    trial = plain.trials[0]
    hall = trial.hall_rad.copy()
    hall[100, 1] += 1.0
    hall[200:210, 2] = np.nan
    changed = dataclasses.replace(
        plain, trials=(dataclasses.replace(trial, hall_rad=hall), *plain.trials[1:])
    )
    assert snaps(changed) == ()


def test_a_static_excess_that_weakens_over_degrees_does_not_snap() -> None:
    assert snaps(dataset(effect("stribeck", static_excess=0.3))) == ()


def turned(deg: float, in_s: float, base_deg: float = 0.0, noise_deg: float = 1e-3) -> Dataset:
    """One trial of 10 s at 200 Hz in which sensors and base turn evenly from 5 s on, in so many seconds."""
    plain = dataset()
    given = plain.trials[0]
    time_s = np.arange(2000) / 200.0
    share = np.clip((time_s - 5.0) / in_s, 0.0, 1.0)
    noise_rad = rad(noise_deg) * np.random.default_rng(3).standard_normal((2000, 4))
    trial = dataclasses.replace(
        given,
        trial=dataclasses.replace(given.trial, time_s=time_s, base_angle_rad=rad(base_deg) * share),
        hall_rad=rad(deg) * share[:, np.newaxis] + noise_rad,
        phase=np.full(2000, "turn"),
    )
    return dataclasses.replace(plain, trials=(trial,))


# a difference of two medians of three samples scatters by 0.95 of their noise
@pytest.mark.parametrize(("sigmas", "seen"), [(1.0, False), (9.0, True)])
def test_a_turn_is_a_snap_far_beyond_its_noise(sigmas: float, seen: bool) -> None:
    assert bool(snaps(turned(0.95 * sigmas, 0.005, noise_deg=1.0))) is seen


@pytest.mark.parametrize(("gain", "seen"), [(1.1, False), (1.4, True)])
def test_a_sensor_may_show_a_quarter_more_than_the_base_turned(gain: float, seen: bool) -> None:
    assert bool(snaps(turned(10.0 * gain, 0.02, 10.0))) is seen


# 5° within the span are 7σ of their noise, the third of them 2.3σ
@pytest.mark.parametrize(("in_s", "seen"), [(0.06, True), (0.18, False)])
def test_a_snap_is_over_within_six_hundredths_of_a_second(in_s: float, seen: bool) -> None:
    assert bool(snaps(turned(5.0, in_s, noise_deg=0.75))) is seen
