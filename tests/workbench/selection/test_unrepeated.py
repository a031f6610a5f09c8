"""No command was repeated: noise that wanders or hums is not called a missing effect, a missing effect is."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from diagnosis_sets import SETUPS
from messy_shapes import SHAPES, recorded

from needle_rig.dataset import Dataset
from needle_rig.physics.effect import Effect
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.unrepeated import left_to_white, under_hum
from tests.workbench.hidden import effect, few

WITHOUT = few("torque_bias", "hall_offset", "clock_offset")


def unrepeated(kind: str, *hidden: Effect, seed: int = 77_001, shape: str = "no replicates") -> Dataset:
    """Hall sensors of 0.12°: what wanders is smaller than what matters."""
    return recorded(SHAPES[shape], hidden, kind, SETUPS[1].noise, seed)


@pytest.mark.parametrize("kind", ["wanders over 2 s", "wanders over 10 s"])
def test_noise_that_wanders_is_nothing_missing(kind: str) -> None:
    found = diagnose(unrepeated(kind), WITHOUT)
    assert found.verdict == "none"
    assert found.held_out_error_before > 1.1
    if found.held_out_error_before > 1.3:
        assert any("without a repeated command nobody can tell" in note for note in found.notes)
        assert {d.decision for d in found.decisions.values()} == {"cannot_tell"}


def test_hum_is_found_by_its_frequency() -> None:
    found = diagnose(unrepeated("hum"), WITHOUT)
    problem, _, validation = found.concluded
    assert found.verdict == "none"
    assert validation.error < 1.1
    assert problem.noise.hum_hz == pytest.approx(0.17, abs=0.005)
    assert "oscillates at 0.17 Hz" in found.notes[0]


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
    baseline = fit_baseline(data, None, library)
    assert under_hum(baseline, baseline.problem, baseline.current) is None


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


def test_what_is_left_is_measured_in_white_noise() -> None:
    def left(kind: str, *hidden: Effect, shape: str = "no replicates") -> float:
        baseline = fit_baseline(unrepeated(kind, *hidden, shape=shape), None, WITHOUT)
        return left_to_white(baseline.problem, baseline.current)

    assert left("white") < 0.3
    assert 0.2 < left("hum") < 0.7  # half the white noise, of which friction and offsets take a part
    assert left("white", effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45)) > 2.0
    assert left("hum", shape="standard series") == math.inf
