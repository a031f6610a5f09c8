"""No command was repeated: noise that wanders or hums is not called a missing effect, a missing effect is."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from diagnosis_sets import SETUPS
from messy_shapes import SHAPES, recorded
from noise_kinds import WANDER_SHARE

from needle_rig.dataset import Dataset
from needle_rig.physics.effect import Effect
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.selection import shown_noise
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.shown_noise import left_over, left_to_white
from tests.workbench.hidden import effect, few

WITHOUT = few("torque_bias", "hall_offset", "clock_offset")


def unrepeated(kind: str, *hidden: Effect, seed: int = 77_001, shape: str = "no replicates") -> Dataset:
    """Hall sensors of 0.12°: what wanders is smaller than what matters."""
    return recorded(SHAPES[shape], hidden, kind, SETUPS[1].noise, seed)


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["wanders over 2 s", "wanders over 10 s"])
def test_noise_that_wanders_is_nothing_missing(kind: str) -> None:
    found = diagnose(unrepeated(kind), WITHOUT)
    noise = found.concluded[0].noise
    assert found.verdict == "none"
    assert found.held_out_error_before < 1.1
    assert noise.correlated / noise.white == pytest.approx(np.full(5, WANDER_SHARE), abs=0.25)
    assert any("is taken for noise drift over seconds" in note for note in found.notes)


@pytest.mark.whole
def test_what_cannot_be_taken_for_noise_and_may_be_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown_noise, "left_over", lambda _, problem, found: problem.noise)
    found = diagnose(unrepeated("wanders over 2 s"), WITHOUT)
    assert found.verdict == "none"
    assert found.held_out_error_before > 1.3
    assert any("without a repeated command nobody can tell" in note for note in found.notes)
    assert {d.decision for d in found.decisions.values()} == {"cannot_tell"}


@pytest.mark.whole
def test_noise_that_wanders_is_no_second_effect() -> None:
    hidden = effect("bearing_drag", torque_nmm=0.0125, viscous_nmms_per_rad=0.0125)
    others = ("platform_friction", "torque_low_pass", "hall_offset", "guide_friction", "layered_friction")
    found = diagnose(unrepeated("wanders over 2 s", hidden, seed=92_003), few("bearing_drag", *others))
    assert found.effects == ("bearing_drag",)


@pytest.mark.parametrize("bias_nmm", [0.0006, 0.0012])
def test_limits_hold_under_noise_that_wanders(bias_nmm: float) -> None:
    data = unrepeated("wanders over 10 s", effect("torque_bias", bias_nmm=bias_nmm))
    limit_nmm = diagnose(data, WITHOUT).decisions["torque_bias"].limit
    assert limit_nmm is not None
    assert bias_nmm < limit_nmm < 0.002


@pytest.mark.whole
def test_a_torque_gain_is_named_for_the_rigidity_that_it_restores() -> None:
    """A rigidity that is off by as much predicts commands left out as well, against what is stated."""
    hidden = effect("torque_gain", gain=1.5)
    found = diagnose(unrepeated("white", hidden), few("torque_gain", "hall_offset", "clock_offset"))
    assert found.held_out_error_after > found.held_out_error_before
    assert found.effects == ("torque_gain",)


@pytest.mark.whole
def test_three_effects_beside_what_may_be_noise_are_not_named() -> None:
    data = unrepeated("wanders over 2 s", effect("hall_eccentricity", cosine_deg=4.0), seed=77_002)
    found = diagnose(data, few("hall_harmonics", "hall_offset", "hall_gain"))
    assert found.verdict == "unknown"


def test_more_than_may_wander_is_no_noise() -> None:
    data = unrepeated("white", effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45))
    baseline = fit_baseline(data, None, WITHOUT)
    assert left_over(baseline, baseline.problem, baseline.current) is baseline.problem.noise


@pytest.mark.whole
def test_where_commands_were_repeated_replicates_must_bear_it_out(monkeypatch: pytest.MonkeyPatch) -> None:
    given = fit_baseline(unrepeated("wanders over 2 s", shape="standard series"), None, WITHOUT)
    known = given.problem.noise
    monkeypatch.setattr(shown_noise, "replicates_favour", lambda *_: False)
    assert left_over(given, given.problem, given.current) is known
    monkeypatch.setattr(shown_noise, "replicates_favour", lambda *_: True)
    assert left_over(given, given.problem, given.current) is not known


@pytest.mark.whole
def test_hum_is_found_by_its_frequency() -> None:
    found = diagnose(unrepeated("hum"), WITHOUT)
    problem, _, validation = found.concluded
    assert found.verdict == "none"
    assert validation.error < 1.1
    assert problem.noise.hum_hz == pytest.approx(0.17, abs=0.005)
    assert any("oscillates at 0.17 Hz" in note for note in found.notes)


@pytest.mark.whole
@pytest.mark.parametrize(
    "hidden",
    [
        effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.02),
        effect("guide_friction", torque_nmm=0.004),
        effect("hall_eccentricity", sine_deg=0.4),
        effect("torque_bias", bias_nmm=0.002),
    ],
)
def test_what_an_effect_leaves_is_no_hum(hidden: Effect) -> None:
    library = few("hall_offset", "clock_offset")
    data = unrepeated("white", hidden)
    assert diagnose(data, library).verdict == "unknown"


@pytest.mark.whole
def test_what_is_missing_and_matters_is_unknown() -> None:
    hidden = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.1)
    for kind in ("white", "wanders over 2 s"):
        found = diagnose(unrepeated(kind, hidden), WITHOUT)
        assert found.verdict == "unknown", kind
        assert not any("nobody can tell" in note for note in found.notes)


def test_a_dead_sensor_leaves_nothing() -> None:
    data = unrepeated("hum")
    trials = []
    for given in data.trials:
        hall_rad = given.hall_rad.copy()
        hall_rad[:, 1] = np.nan
        trials.append(
            dataclasses.replace(given, torque_nm=np.full_like(given.torque_nm, np.nan), hall_rad=hall_rad)
        )
    baseline = fit_baseline(dataclasses.replace(data, trials=tuple(trials)), None, WITHOUT)
    assert 0.0 < left_to_white(baseline.problem, baseline.current) < 1.0


@pytest.mark.whole
def test_what_is_left_is_measured_in_white_noise() -> None:
    def left(kind: str, *hidden: Effect, shape: str = "no replicates") -> float:
        baseline = fit_baseline(unrepeated(kind, *hidden, shape=shape), None, WITHOUT)
        return left_to_white(baseline.problem, baseline.current)

    assert left("white") < 0.3
    assert 0.2 < left("hum") < 0.7  # half the white noise, of which friction and offsets take a part
    assert left("white", effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45)) > 2.0
    assert left("hum", shape="standard series") == math.inf
