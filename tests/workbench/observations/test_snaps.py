"""A needle that snaps is seen in the data alone; one that only resists never looks like it."""

import dataclasses

import numpy as np
import pytest

from needle_rig.physics.library import find_effects
from needle_rig.workbench.observations.snaps import sentence, snaps
from tests.workbench.hidden import dataset, effect

FALLING = ("stribeck", "stiction_ageing", "bending_torque")
"""Whose resistance falls with the rate, the slip or the angle."""
RESISTING = sorted(set(find_effects()) - set(FALLING))


def snapping():
    return dataset(effect("stribeck", static_excess=1.0, rate_deg_s=11.5, weakening_deg=0.8))


def test_a_needle_that_snaps_is_seen_with_place_and_size():
    found = snaps(snapping())
    assert found
    assert abs(found[0].turned_deg) > 1.25 * found[0].base_deg
    assert [abs(s.turned_deg) for s in found] == sorted((abs(s.turned_deg) for s in found), reverse=True)
    told = sentence(found)
    assert found[0].file in told
    assert found[0].sensor in told
    assert "stick-slip" in told


@pytest.mark.parametrize("name", RESISTING)
def test_no_effect_that_only_resists_looks_like_a_snap(name):
    assert snaps(dataset(find_effects()[name].at_strength(3.0), seed=5)) == ()


@pytest.mark.parametrize("seed", range(1, 6))
def test_nothing_hidden_is_no_snap(seed):
    found = snaps(dataset(seed=seed))
    assert found == ()
    assert sentence(found) == ""


def test_a_wild_sample_or_a_missing_one_is_no_snap():
    plain = dataset()
    trial = plain.trials[0]
    hall = trial.hall_rad.copy()
    hall[100, 1] += 1.0
    hall[200:210, 2] = np.nan
    changed = dataclasses.replace(
        plain, trials=(dataclasses.replace(trial, hall_rad=hall), *plain.trials[1:])
    )
    assert snaps(changed) == ()


def test_a_static_excess_that_weakens_over_degrees_does_not_snap():
    assert snaps(dataset(effect("stribeck", static_excess=0.3))) == ()
