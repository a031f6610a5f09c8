"""Runs one after the other without relaxing the needle: each begins as those before it left the shaft."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaigns.workbench.messy_shapes import SHAPES, recorded
from needle_rig.dataset import Dataset
from needle_rig.dataset.dominant_turns import arrival, dominant_turns
from needle_rig.dataset.protocol import Protocol, staircase
from needle_rig.model import load_parameters
from needle_rig.physics.library import find_effects
from needle_rig.recording import RunFile, RunWriter, run_tables
from needle_rig.units import deg, rad
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.estimation.parameters import scaled_values_of
from needle_rig.workbench.estimation.posterior import start_vector
from needle_rig.workbench.learning.identify import identify
from needle_rig.workbench.observations.earlier_path import PHASE, with_path_before
from needle_rig.workbench.observations.sources import read_measurements
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise
from tests.recorded_run import write_run
from tests.values import known
from tests.workbench.hidden import dataset, effect, few

STEPS_DEG = (45.0, 71.0, 25.0, 52.0, 45.0, -45.0, -65.0, -25.0, -52.0, -45.0, 60.0, 86.0, 40.0, 66.0, 60.0)
ENDS = ("step_5", "step_10", "step_15")


def attributes(run: RunFile) -> dict[str, Any]:
    """What a run says of itself, without what belongs to its end."""
    return {name: run.attributes[name] for name in ("config", "strategy", "target_deg", "started_utc")}


@pytest.fixture(scope="module")
def whole() -> Dataset:
    """One long trial of a needle in elastic tissue, which forgets no angle."""
    protocol = Protocol("long", (staircase(STEPS_DEG, 45.0, 1.0),))
    return simulate_dataset(load_parameters("rig_elastic"), protocol, 5)


@pytest.fixture
def runs(whole: Dataset, tmp_path: Path, run_path: Path) -> list[Path]:
    """The same as three runs."""
    (trial,), written, first = whole.trials, [], 0
    for number, end in enumerate(ENDS):
        last = int(np.flatnonzero(trial.phase == end)[-1]) + 1
        here = slice(max(first - 10, 0), last)
        ticks = np.zeros(last - here.start, run_tables(sensors=4)["ticks"])
        ticks["time_s"], ticks["dt_s"] = trial.trial.time_s[here], 0.02
        ticks["phase"], ticks["motion"] = b"moving", trial.phase[here]
        ticks["base_angle_rad"] = trial.base_measured_rad[here]
        ticks["torque_nm"], ticks["hall_rad"] = trial.torque_nm[here], trial.hall_rad[here]
        written.append(tmp_path / f"2026-11-23_10-00-0{number}Z.h5")
        with RunWriter(written[-1], attributes(RunFile(run_path)), run_tables(sensors=4)) as writer:
            writer.append("ticks", ticks)
        first = last
    return written


def stiffness(path: Path) -> tuple[float, float, float]:
    """(tissue's stiffness, its uncertainty, what is left in units of the noise), by the true model."""
    found = identify(read_measurements([path]), find_effects(), load_parameters("rig_elastic"))
    (estimate,) = (e for e in found.estimates if e.name.startswith("tissue_elasticity"))
    return known(estimate.value), known(estimate.uncertainty), found.misfit


def test_a_run_begins_as_the_runs_before_it_left_the_shaft(runs: list[Path]) -> None:
    for path, turns in zip(runs[1:], ("71, 25, 52, 45", "71, -65, -25, -52, -45"), strict=True):
        dataset = read_measurements([path])
        assert dataset.trials[0].start == "relaxed"
        assert np.isnan(dataset.trials[0].hall_rad[dataset.trials[0].phase == PHASE]).all()
        assert f"left the shaft, after turns of the base to {turns}°" in dataset.notes[-1]
        value, uncertainty, misfit = stiffness(path)
        assert abs(value - 0.278) < 3.0 * uncertainty
        assert uncertainty < 0.01
        assert misfit < 1.2


@pytest.mark.whole
def test_without_the_run_before_the_twist_is_unknown(runs: list[Path]) -> None:
    _, told, _ = stiffness(runs[2])
    runs[1].unlink()
    assert read_measurements([runs[2]]).trials[0].start == "wound"
    assert stiffness(runs[2])[1] > 1.2 * told
    assert read_measurements([runs[0]]).trials[0].start == "relaxed"


def test_a_needle_that_was_moved_between_two_runs_begins_with_an_unknown_twist(runs: list[Path]) -> None:
    for column, moved_deg in (("base_angle_rad", 1.5), ("hall_rad", 1.5)):
        run = RunFile(runs[1])
        ticks = run.table("ticks")
        ticks[column] += rad(moved_deg)
        path = runs[1].with_name("2026-11-23_10-00-01Zm.h5")
        with RunWriter(path, attributes(run), run_tables(sensors=4)) as writer:
            writer.append("ticks", ticks)
        assert read_measurements([path]).trials[0].start == "wound"
        path.unlink()


def test_a_run_of_another_rig_winds_nothing(runs: list[Path], run_path: Path) -> None:
    other = runs[1].with_name("2026-11-23_10-00-01Zz.h5")
    rig = attributes(RunFile(run_path))
    rig["config"] = str(rig["config"]).replace("length_mm: 397", "length_mm: 398")
    with RunWriter(other, rig, run_tables(sensors=4)) as writer:
        writer.append("ticks", RunFile(runs[1]).table("ticks"))
    assert read_measurements([runs[2]]).trials[0].start == "wound"


def test_a_run_from_rest_after_one_that_ended_elsewhere_is_relaxed(tmp_path: Path) -> None:
    write_run(tmp_path / "a.h5", pictures=False)
    second = write_run(tmp_path / "b.h5", pictures=False)
    dataset = read_measurements([second])
    assert dataset.trials[0].start == "relaxed"
    assert PHASE not in dataset.trials[0].phase


@pytest.mark.parametrize(
    ("path_deg", "turns_deg"),
    [
        ((), []),
        ((10.0, 45.0, 30.0), [45.0, 30.0]),
        ((45.0, 30.0, 45.0, 20.0), [45.0, 20.0]),
        ((45.0, -50.0, 30.0, 10.0, 20.0), [-50.0, 30.0, 10.0, 20.0]),
        ((-5.0, 3.0, -5.0, 0.0), [-5.0, 0.0]),
        ((45.0, 44.98, 45.0, 44.97), [45.0]),
    ],
)
def test_turns_that_are_passed_again_are_forgotten(
    path_deg: tuple[float, ...], turns_deg: list[float]
) -> None:
    path = rad(np.array(path_deg, dtype=np.float64))
    assert [round(deg(path[place]), 3) for place in dominant_turns(path)] == turns_deg


def test_a_base_stands_since_it_came_to_where_it_is() -> None:
    path = rad(np.array([0.0, 30.0, 45.0, 45.03, 44.98, 45.01, 10.0]))
    assert arrival(path, 5) == 2
    assert arrival(path, 6) == 6
    assert arrival(path[2:], 1) == 0


def test_a_path_with_times_comes_to_its_corners_then_and_stands_between() -> None:
    given = dataset().trials[0]
    corners, came_s = [rad(80.0), rad(-60.0), rad(20.0)], (9.0, 8.5, 4.0)
    trial = with_path_before(given, corners, came_s).trial
    begin_s = float(given.trial.time_s[0])
    assert np.all(np.diff(trial.time_s) > 0)
    before = trial.time_s < begin_s
    at_s = [begin_s - 11.0, begin_s - 9.0, begin_s - 8.5, begin_s - 6.001, begin_s - 4.0]
    seen = np.interp(at_s, trial.time_s[before], trial.base_angle_rad[before])
    assert deg(seen) == pytest.approx([0.0, 80.0, -60.0, -60.0, 20.0], abs=0.1)
    assert trial.base_angle_rad[before][-1] == given.trial.base_angle_rad[0]


def test_a_path_without_times_turns_without_a_stop() -> None:
    given = dataset().trials[0]
    corners = [rad(80.0), rad(-60.0)]
    base_rad = float(given.trial.base_angle_rad[0])
    plain = with_path_before(given, corners).trial
    timed = with_path_before(given, [*corners, base_rad], (5.0, 3.0, 1.0)).trial
    assert timed.time_s == pytest.approx(plain.time_s)
    assert timed.base_angle_rad == pytest.approx(plain.base_angle_rad)


@pytest.mark.whole
@pytest.mark.parametrize("timed", [True, False])
def test_friction_that_ages_remembers_when_the_base_turned(timed: bool) -> None:
    """In one long recording the shaft stands 4 s before a trial, as it does not after turns without times."""
    hidden = (effect("stiction_ageing", growth_per_decade=0.4, rest_time_s=1.0),)
    data = recorded(SHAPES["long recording"], hidden, "white", Noise(friction_scatter=0.0), 5)
    assert all(t.turns_before_s for t in data.trials[1:])
    if not timed:
        trials = (dataclasses.replace(t, turns_before_s=()) for t in data.trials)
        data = dataclasses.replace(data, trials=tuple(trials))
    problem = fit_baseline(data, None, few("stiction_ageing")).problem
    parameters = problem.parameters(["stiction_ageing"])
    friction_n = load_parameters("rig_rigid").friction_n
    true = start_vector(problem, float(np.log(friction_n)), parameters)
    true = dataclasses.replace(true, scaled_values=scaled_values_of(parameters, hidden))
    residuals = problem.residuals(problem.predict(parameters, true), range(len(data.trials)))
    worst = max(float(np.sqrt(np.mean(r**2))) for r in residuals[1:])
    assert (worst < 1.1) is timed
