"""No command was repeated: noise that wanders or hums is not called a missing effect, a missing effect is."""

from __future__ import annotations

import numpy as np
import pytest

from campaigns.workbench.diagnosis_sets import SETUPS
from campaigns.workbench.messy_shapes import SHAPES, recorded
from campaigns.workbench.noise_kinds import WANDER_SHARE
from needle_rig.dataset import Dataset
from needle_rig.physics.effect import Effect
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.shown_noise import left_over
from tests.workbench.hidden import effect, few

WITHOUT = few("torque_bias", "hall_offset", "clock_offset")


def unrepeated(kind: str, *hidden: Effect, seed: int = 77_001, shape: str = "no replicates") -> Dataset:
    """Hall sensors of 0.12°: what wanders is smaller than what matters."""
    return recorded(SHAPES[shape], hidden, kind, SETUPS[1].noise, seed)


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["wanders over 2 s", "wanders over 10 s"])
def test_noise_that_wanders_is_nothing_missing(kind: str) -> None:
    found = diagnose(unrepeated(kind), WITHOUT)
    (term,) = found.concluded[0].noise.shown
    assert found.verdict == "none"
    assert found.held_out_error_before < 1.1
    white = found.concluded[0].noise.white
    assert term.sd / white == pytest.approx(np.full(5, WANDER_SHARE), abs=0.3)
    assert any("is taken for noise drift over seconds" in note for note in found.notes)


@pytest.mark.whole
def test_noise_that_wanders_is_no_second_effect() -> None:
    hidden = effect("bearing_drag", torque_nmm=0.0125, viscous_nmms_per_rad=0.0125)
    others = ("platform_friction", "torque_low_pass", "hall_offset", "guide_friction", "layered_friction")
    found = diagnose(unrepeated("wanders over 2 s", hidden, seed=92_003), few("bearing_drag", *others))
    assert found.effects == ("bearing_drag",)


@pytest.mark.parametrize("bias_nmm", [0.0006, pytest.param(0.0012, marks=pytest.mark.whole)])
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
def test_hum_is_found_by_its_frequency() -> None:
    found = diagnose(unrepeated("hum"), WITHOUT)
    problem, _, validation = found.concluded
    assert found.verdict == "none"
    assert validation.error < 1.1
    assert problem.noise.shown[0].form == pytest.approx(0.17, abs=0.005)
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
