"""One trial that differs from all others is told, and left out where its command was repeated."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import Protocol, compensation
from needle_rig.model import load_parameters
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.odd_trial import OddTrial, chance_of_largest, odd_trial, without
from needle_rig.workbench.virtual.dataset import simulate_dataset
from tests.workbench.hidden import dataset, few, null_fit

REPEATED, ALONE = 1, 2
"""Places of a trial whose command was repeated, and of one whose was not."""


SERIES = Protocol("eight", tuple(compensation(deg) for deg in (45, 45, -60, 45, 30, 30, -45, -45)))


def bumped(place: int) -> Dataset:
    """Eight trials with nothing hidden, in one of which the table was bumped at 6 s."""
    given = simulate_dataset(load_parameters("rig_rigid"), SERIES, 1, name="bumped")
    trial = given.trials[place]
    since = (trial.trial.time_s > 6.0).astype(float)
    hit = dataclasses.replace(
        trial,
        torque_nm=trial.torque_nm + 1e-5 * since,
        hall_rad=trial.hall_rad + np.multiply.outer(since, np.radians([2.0, -1.0, 3.0, 1.0])),
    )
    return dataclasses.replace(
        given, trials=tuple(hit if k == place else t for k, t in enumerate(given.trials))
    )


def test_chance_calls_one_trial_odd_as_often_as_is_said() -> None:
    random = np.random.default_rng(3)
    drawn = np.exp(0.3 * random.standard_normal((4000, 8)) + 2.0)
    seen = np.mean([chance_of_largest(row) < 0.05 for row in drawn])
    assert seen == pytest.approx(0.05, abs=3 * np.sqrt(0.05 * 0.95 / 4000))


@pytest.mark.parametrize(
    ("mean_squares", "odd"),
    [
        ((0.7, 0.8, 0.75, 0.65, 0.7, 0.8, 0.72, 6.0), True),
        ((0.7, 0.8, 0.75, 0.65, 0.7, 0.8, 0.72, 1.0), False),
        ((0.7, 8.0, 0.75, 3.0, 0.7, 40.0, 0.72, 60.0), False),  # a law that shows at some commands more
        ((0.7, 0.7, 60.0), False),
        ((0.7, 0.7, 0.7, 60.0), False),  # alike to the last bit: no spread to hold it against
    ],
)
def test_a_trial_is_odd_against_the_spread_of_the_others(mean_squares: tuple[float, ...], odd: bool) -> None:
    assert (chance_of_largest(mean_squares) < POLICY.evidence.false_alarm) is odd


@pytest.mark.parametrize(("t", "odd"), [(7.3, False), (8.1, True)])
def test_of_eight_trials_one_in_a_thousand_is_called_odd(t: float, odd: bool) -> None:
    others = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, 0.0])
    last = t * others.std(ddof=1) * np.sqrt(1.0 + 1.0 / 7.0)
    trials: Any = [SimpleNamespace(trial=SimpleNamespace(index=k), file=f"{k}.csv") for k in range(8)]
    problem: Any = SimpleNamespace(recorded=np.arange(8), trials=trials, groups=[[0, 7], [1, 2, 3, 4, 5, 6]])
    sizes = np.exp(np.r_[others, last])
    found: Any = SimpleNamespace(residuals=[np.full(4, np.sqrt(size)) for size in sizes])
    told = odd_trial(problem, found)
    assert (told is not None) is odd
    if told is not None:
        assert (told.index, told.file, told.repeated) == (7, "7.csv", True)
        assert told.left == pytest.approx(np.sqrt(sizes[7]))
        assert told.others == pytest.approx(np.sqrt(sizes[:7].mean()))


def test_without_it_the_others_keep_their_places() -> None:
    odd = OddTrial(1, "trials/02.csv", 3.0, 1.0, 1e-5, True)
    left = without(dataset(), odd)
    assert [t.trial.index for t in left.trials] == [0, 2, 3, 4]
    assert left.trials[1].trial.travel_before_rad == dataset().trials[2].trial.travel_before_rad


def test_no_trial_of_a_series_is_odd_that_nobody_bumped() -> None:
    baseline = null_fit()
    assert odd_trial(baseline.problem, baseline.current) is None


@pytest.mark.parametrize(("place", "repeated"), [(REPEATED, True), (ALONE, False)])
def test_a_bumped_trial_is_told_by_its_file(place: int, repeated: bool) -> None:
    baseline = fit_baseline(bumped(place), None, few())
    told = odd_trial(baseline.problem, baseline.current)
    assert told is not None
    assert (told.file, told.repeated) == (f"trials/0{place + 1}.csv", repeated)
    assert told.left > 2.0 * told.others


@pytest.mark.whole
@pytest.mark.timeout(120)
def test_a_diagnosis_answers_without_it_where_its_command_was_repeated() -> None:
    found = diagnose(bumped(REPEATED), few())
    assert found.verdict == "none"
    assert found.notes[0].startswith("trials/02.csv differs from all other trials")
    assert found.notes[0].endswith("It is left out of this answer.")
    assert len(found.baseline.dataset.trials) == 7


@pytest.mark.whole
@pytest.mark.timeout(120)
def test_a_diagnosis_names_it_and_stays_unknown_where_its_command_was_not() -> None:
    found = diagnose(bumped(ALONE), few())
    assert found.verdict == "unknown"
    assert found.notes[0].startswith("trials/03.csv differs from all other trials")
    assert found.notes[0].endswith("repeat it.")
