import dataclasses
import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from needle_rig.dataset import Dataset
from needle_rig.errors import SolverError
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Reading, parameter
from needle_rig.physics.rod import Rod
from needle_rig.physics.solution import Path, Sampled
from needle_rig.physics.solver import solve_series
from needle_rig.workbench.estimation import simulator as simulator_module
from needle_rig.workbench.estimation.baseline import null_model
from needle_rig.workbench.estimation.posterior import start_vector
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.estimation.simulator import CACHE_ENTRIES, Simulator
from needle_rig.workbench.observations.binning import bin_trial
from needle_rig.workbench.observations.measured_noise import measure_noise
from needle_rig.workbench.observations.noise_terms.white import White
from tests.workbench.hidden import dataset, few


def problem_of(data: Dataset) -> Problem:
    trials = tuple(bin_trial(t) for t in data.trials)
    base = dataclasses.replace(null_model(data), element_length_m=4e-3)
    return Problem("toy", base, few(), trials, measure_noise(data.trials, trials), 0.02)


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many trials each call solved."""
    counts: list[int] = []

    def counted(rod: Rod, paths: Sequence[Path], factors: Array, **options: Any) -> list[list[Sampled]]:
        counts.append(len(paths))
        return solve_series(rod, paths, factors, **options)

    monkeypatch.setattr(simulator_module, "solve_series", counted)
    return counts


def test_what_moves_the_needle_is_solved_once_and_seen_by_other_sensors(solved: list[int]) -> None:
    problem = problem_of(dataset())
    vector = start_vector(problem, np.log(1e-3))
    first = problem.predict((), vector)
    again = problem.predict((), vector)
    parameters = problem.parameters(["torque_bias"])
    biased = problem.predict(parameters, dataclasses.replace(vector, scaled_values=np.ones(1)))
    problem.predict((), dataclasses.replace(vector, log_friction=np.log(2e-3)))
    assert solved == [len(problem.trials)] * 2
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert all(np.ptp((b - a)[0]) < 1e-12 < abs((b - a)[0, 0]) for a, b in zip(first, biased, strict=True))


def test_another_path_of_the_same_trial_is_solved_again(solved: list[int]) -> None:
    problem = problem_of(dataset())
    vector = start_vector(problem, np.log(1e-3))
    before = problem.predict((), vector)
    turned = [
        dataclasses.replace(
            b, trial=dataclasses.replace(b.trial, base_angle_rad=1.1 * b.trial.base_angle_rad)
        )
        for b in problem.trials
    ]
    shared = problem.over(turned)
    alone = dataclasses.replace(shared, simulator=Simulator())
    assert shared.simulator is problem.simulator
    for seen, own, old in zip(shared.predict((), vector), alone.predict((), vector), before, strict=True):
        assert np.array_equal(seen, own)
        assert not np.allclose(seen, old)


def test_other_means_and_noise_share_what_was_solved(solved: list[int]) -> None:
    problem = problem_of(dataset())
    vector = start_vector(problem, np.log(1e-3))
    means = problem.predict((), vector)
    perfect = problem.with_means(means)
    louder = problem.with_noise(problem.noise.having(White(2.0 * problem.noise.white)))
    rows = perfect.residuals(perfect.predict((), vector), range(len(means)))
    louder.predict((), vector)
    assert solved == [len(problem.trials)]
    assert max(np.abs(r).max() for r in rows) == 0.0
    assert perfect.whiteners is problem.whiteners
    assert louder.whiteners is not problem.whiteners


def test_a_problem_does_not_change_and_goes_to_another_process_without_what_was_solved() -> None:
    problem = problem_of(dataset())
    size = len(pickle.dumps(problem))
    vector = start_vector(problem, np.log(1e-3))
    here = problem.predict((), vector)
    assert len(pickle.dumps(problem)) == size
    there = pickle.loads(pickle.dumps(problem)).predict((), vector)
    assert all(np.array_equal(a, b) for a, b in zip(here, there, strict=True))
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.noise = None  # type: ignore[misc, assignment]


def test_only_so_much_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulator_module, "CACHE_ENTRIES", 7)
    problem = problem_of(dataset())
    for friction_n in (1e-3, 2e-3, 4e-3):
        problem.predict((), start_vector(problem, np.log(friction_n)))
    assert len(problem.simulator._kept) == 7 < CACHE_ENTRIES


def test_a_needle_that_takes_too_many_solves_is_not_followed_even_when_it_is_known() -> None:
    problem = problem_of(dataset())
    vector = start_vector(problem, np.log(1e-3))
    problem.predict((), vector)
    with pytest.raises(SolverError, match="too many balances"):
        problem.predict((), vector, most_solves=0.01)


@dataclass(frozen=True)
class FarOut(Effect):
    """A reading that overflows."""

    size: float = parameter(
        off=0.0, lower=-10.0, upper=10.0, typical=1.0, smallest=0.1, literature=(-10.0, 10.0), unit="1"
    )

    def observe(self, reading: Reading) -> Reading:
        return dataclasses.replace(reading, torque_nm=np.exp(self.size * 1e4 * np.abs(reading.trial.time_s)))


def test_a_law_that_overflows_gives_readings_that_are_not_finite_and_no_warning() -> None:
    problem = problem_of(dataset())
    given = problem.trials[0]
    (reading,) = Simulator().readings([problem.base.with_effects(FarOut(1.0))], [given])
    assert not np.isfinite(reading[0]).all()
    assert np.isfinite(reading[1:]).all()


def test_trials_of_one_model_are_those_that_each_would_be_by_itself() -> None:
    problem = problem_of(dataset())
    names = ["tissue_elasticity", "chuck_backlash", "mount_compliance", "hall_gain"]
    problem = dataclasses.replace(problem, library=few(*names))
    parameters = problem.parameters(names)
    friction = np.linspace(-0.3, 0.3, len(problem.trials))
    vector = dataclasses.replace(
        start_vector(problem, np.log(1e-3), parameters),
        scaled_values=np.full(len(parameters), 0.5),
        trial_friction=friction,
    )
    together = problem.predict(parameters, vector)
    for t, (binned, seen) in enumerate(zip(problem.trials, together, strict=True)):
        reading = problem.model(parameters, vector, t).predict(binned.trial)
        alone = binned.averaged(np.vstack([reading.torque_nm[None, :], reading.hall_rad.T]))
        np.testing.assert_array_equal(seen, alone)


def test_an_effect_that_asks_for_the_place_in_the_series_has_a_rod_a_trial(solved: list[int]) -> None:
    problem = dataclasses.replace(problem_of(dataset()), library=few("friction_wear"))
    parameters = problem.parameters(["friction_wear"])
    at = dataclasses.replace(start_vector(problem, np.log(1e-3), parameters), scaled_values=np.array([2.0]))
    seen = problem.predict(parameters, at)
    assert solved == [1] * len(problem.trials)
    for t, binned in enumerate(problem.trials):
        reading = problem.model(parameters, at, t).predict(binned.trial)
        alone = binned.averaged(np.vstack([reading.torque_nm[None, :], reading.hall_rad.T]))
        np.testing.assert_array_equal(seen[t], alone)
