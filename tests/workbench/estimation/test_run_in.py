"""Shafts that were wound when the recording began."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.dataset.protocol import Protocol, compensation, staircase
from needle_rig.dataset.records import Start
from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.physics import effects as built_in
from needle_rig.physics.effect import Reading
from needle_rig.physics.library import load_effect
from needle_rig.units import deg, nm, rad
from needle_rig.workbench.estimation.baseline import fit_baseline, judged, null_model
from needle_rig.workbench.estimation.run_in import Wound, wound
from needle_rig.workbench.learning.compare import compare
from needle_rig.workbench.observations.binning import bin_trial
from needle_rig.workbench.observations.earlier_path import PHASE
from needle_rig.workbench.parallel import Processes
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.residual_patterns import find_residual_patterns
from needle_rig.workbench.virtual.dataset import simulate_dataset
from tests.workbench.hidden import dataset, effect, few

DIAGNOSE = "needle_rig.workbench.selection.diagnose"

WIDE = Protocol(
    "wide",
    (
        staircase((60.0, -60.0, 60.0, -60.0, 30.0), 45.0, 1.0),
        staircase((-60.0, 60.0, -60.0, 60.0, -30.0), 45.0, 1.0),
        compensation(45.0),
    ),
)


def begun_late(trial: DatasetTrial, phase: str, start: Start) -> DatasetTrial:
    """The trial from shortly before the motion `phase` on; its readings from there, if they are zeroed."""
    first = int(np.flatnonzero(trial.phase == phase)[0]) - 10
    torque, hall = trial.torque_nm[first:].copy(), trial.hall_rad[first:].copy()
    if start == "zeroed":
        torque, hall = torque - torque[:5].mean(), hall - hall[:5].mean(axis=0)
    time_s = trial.trial.time_s[first:] - trial.trial.time_s[first]
    return dataclasses.replace(
        trial,
        trial=dataclasses.replace(
            trial.trial, time_s=time_s, base_angle_rad=trial.trial.base_angle_rad[first:]
        ),
        base_measured_rad=trial.base_measured_rad[first:],
        torque_nm=torque,
        hall_rad=hall,
        phase=trial.phase[first:],
        start=start,
    )


@pytest.fixture(scope="module")
def wide() -> Dataset:
    return simulate_dataset(load_parameters("rig_rigid"), WIDE, 3)


@pytest.fixture(scope="module")
def wide_begun_late(wide: Dataset) -> Dataset:
    late = [begun_late(t, "step_2", "wound") for t in wide.trials[:2]]
    return dataclasses.replace(wide, trials=(*late, wide.trials[2]))


def test_relaxed_starts_are_left_as_they_are(wide: Dataset) -> None:
    assert judged(wide) is wide


@pytest.mark.whole
def test_readings_that_depend_on_the_start_are_left_out(wide: Dataset, wide_begun_late: Dataset) -> None:
    found = judged(wide_begun_late)
    for trial, given in zip(found.trials[:2], wide_begun_late.trials[:2], strict=True):
        recorded = trial.phase != PHASE
        assert np.array_equal(trial.trial.base_angle_rad[recorded], given.trial.base_angle_rad)
        assert np.isnan(trial.hall_rad[~recorded]).all()
        judged_hall = np.isfinite(trial.hall_rad[recorded])
        assert not judged_hall[:20, 3].any()
        assert judged_hall[-50:].all()
    assert found.trials[2] is wide_begun_late.trials[2]
    said = [note for note in found.notes if "run-in" in note]
    assert len(said) == 1
    whose, *_, judged_from = said[0].split("; ")
    assert whose == "trials/01.csv and 1 more begin with an unknown twist"
    assert "torque from" in judged_from
    assert "hall_4 from" in judged_from
    assert not any(t.start_found for t in found.trials)


@pytest.mark.whole
def test_the_friction_found_after_a_run_in_is_that_of_relaxed_starts(
    wide: Dataset, wide_begun_late: Dataset
) -> None:
    whole, late = (compare(d, few("torque_bias")) for d in (wide, wide_begun_late))
    name = "friction_nmm_per_100mm"
    assert late.free_parameters[name]["value"] == pytest.approx(
        whole.free_parameters[name]["value"], rel=0.015
    )
    assert late.held_out_error < 1.15
    assert late.refit.reduced_chi2 < 1.15


@pytest.mark.whole
@pytest.mark.parametrize("start", ["wound", "zeroed"])
def test_a_start_that_is_never_forgotten_is_fitted(start: Start) -> None:
    # Reed's sequence goes back by less than twice the lag: its end still depends on the beginning
    whole = dataset(seed=4)
    late = [begun_late(t, "overshoot" if "overshoot" in t.phase else "step_2", start) for t in whole.trials]
    given = dataclasses.replace(whole, trials=tuple(late))
    baseline = fit_baseline(given, None, few("torque_bias"))
    said = [note for note in baseline.dataset.notes if "the start is fitted as a turn of" in note]
    assert len(said) == 5
    assert "turn of -" in said[2]
    assert not any("turn of -" in said[k] for k in (0, 1, 4))
    # turned by 45° the whole shaft slips: told as a turn in which it does so with more friction, too
    turned = [abs(int(found[1])) for note in said if (found := re.search(r"turn of (-?\d+)°", note))]
    assert min(turned[k] for k in (0, 1, 2, 4)) >= 40
    assert baseline.validation.error < 1.15
    assert np.exp(baseline.current.vector.log_friction) * 100 == pytest.approx(0.0983, rel=0.02)
    # neither of a shaft that slips whole with the guessed friction alone, nor of where readings were zeroed
    assert not find_residual_patterns(baseline.problem, baseline.current, given.sensor_names).patterns


def test_a_path_before_a_trial_winds_the_shaft_as_a_turn_from_relaxed_does() -> None:
    trial = dataset(seed=4).trials[0]
    model = load_parameters("rig_rigid")
    still = dataclasses.replace(trial.trial, base_angle_rad=np.zeros_like(trial.trial.time_s))
    given = dataclasses.replace(trial, trial=still)
    seen = []
    for turn_deg in (-400.0, -12.0, 0.0, 12.0, 400.0):
        reading = model.predict(wound(given, rad(turn_deg), rad(26.0)).trial)
        seen.append((reading.torque_nm[-1], *reading.hall_rad[-1]))
    torque, *hall = np.array(seen).T
    assert torque[2] == pytest.approx(0.0, abs=nm(0.008))
    assert torque == pytest.approx(-torque[::-1], abs=nm(0.008))
    turned = model.predict(dataclasses.replace(still, base_angle_rad=np.full_like(still.time_s, rad(12.0))))
    assert torque[3] == pytest.approx(turned.torque_nm[-1], rel=0.05)
    # farther round at every place, in the order of the turns: the tip lags most
    for angle in hall:
        assert (np.diff(angle) <= rad(0.2)).all()
    assert deg(hall[3][0]) == pytest.approx(26.0, abs=2.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 22])
def test_where_every_trial_is_wound_the_starts_are_found_with_what_is_missing(seed: int) -> None:
    whole = dataset(effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45), seed=seed)
    late = [begun_late(t, "overshoot" if "overshoot" in t.phase else "step_2", "wound") for t in whole.trials]
    found = diagnose(dataclasses.replace(whole, trials=tuple(late)), few())
    assert (found.verdict, found.effects) == ("effect", ("tissue_elasticity",))
    value = found.ranking[0].values[0]
    assert value.low < 0.45 < value.high


@pytest.mark.parametrize(("turn_rad", "lag_rad"), [(0.3, 0.4), (-2.0, 1.5), (0.0, 0.4), (1e-3, 0.01)])
def test_a_trial_after_any_turn_is_that_in_bins_after_its_whole_path(turn_rad: float, lag_rad: float) -> None:
    given = begun_late(dataset(seed=23).trials[3], "step_2", "wound")
    binned, quick = bin_trial(wound(given, turn_rad, lag_rad)), Wound.of(given).after(turn_rad, lag_rad)
    model, begin_s = null_model(dataset(seed=23)), given.trial.time_s[0]
    whole, again = (model.predict(b.trial) for b in (binned, quick))
    for one, other in (
        (binned.mean, quick.mean),
        (binned.averaged(_rows(whole)), quick.averaged(_rows(again))),
    ):
        seen, same = one[:, binned.time_s >= begin_s], other[:, quick.time_s >= begin_s]
        assert np.isfinite(seen).all()
        np.testing.assert_allclose(seen, same, rtol=0.0, atol=1e-9)


def _rows(reading: Reading) -> Array:
    return np.vstack([reading.torque_nm, reading.hall_rad.T])


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("start", ["wound", "zeroed"])
def test_friction_at_the_tip_is_not_taken_for_less_wound_starts(start: Start) -> None:
    whole = dataset(effect("tip_friction", torque_nmm=0.03), seed=23)
    late = [begun_late(t, "overshoot" if "overshoot" in t.phase else "step_2", start) for t in whole.trials]
    library = few("tip_friction", "platform_friction", "bending_torque", "hall_gain", "tissue_elasticity")
    found = diagnose(dataclasses.replace(whole, trials=tuple(late)), library)
    assert (found.verdict, found.effects) == ("effect", ("tip_friction",))
    value = found.ranking[0].values[0]
    assert value.value == pytest.approx(0.03, rel=0.1)
    assert found.held_out_error_after < 1.1


@pytest.mark.whole
def test_an_effect_is_named_at_its_size_beside_wound_starts_that_it_finds_itself() -> None:
    whole = dataset(effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45), seed=4)
    trials = list(whole.trials)
    for place in (2, 4):
        trials[place] = begun_late(trials[place], "overshoot", "wound")
    said: list[str] = []
    found = diagnose(dataclasses.replace(whole, trials=tuple(trials)), few(), say=said.append)
    assert "going on from the initial twists that what was found holds" in said
    assert (found.verdict, found.effects) == ("effect", ("tissue_elasticity",))
    assert found.ranking[0].values[0].value == pytest.approx(0.45, rel=0.01)
    assert found.held_out_error_after < 1.1


@pytest.mark.whole
def test_a_users_effect_that_holds_the_shaft_is_found_in_processes_of_their_own(tmp_path: Path) -> None:
    given = (Path(built_in.__path__[0]) / "tissue_elasticity.py").read_text()
    (tmp_path / "my_elasticity.py").write_text(given)
    effects = {"my_elasticity": load_effect(tmp_path / "my_elasticity.py")}
    whole = dataset(effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45), seed=4)
    late = begun_late(whole.trials[2], "overshoot", "wound")
    data = dataclasses.replace(whole, trials=(*whole.trials[:2], late))
    with Processes(2) as work:
        found = diagnose(data, effects, quick=True, work=work)
    assert found.effects == ("my_elasticity",)
    problem, best, _ = found.concluded
    assert best.chi2 < 1.3 * problem.size


@pytest.mark.whole
def test_after_a_run_in_no_starts_are_looked_for(wide_begun_late: Dataset) -> None:
    said: list[str] = []
    found = diagnose(wide_begun_late, few("torque_bias"), quick=True, say=said.append)
    assert found.verdict == "none"
    assert not any("initial twists" in line for line in said)
