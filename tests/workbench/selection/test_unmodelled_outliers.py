"""Outliers while the base moves, where no median tells them: beside a fit they stand out."""

import dataclasses
import functools

import numpy as np
import pytest

from needle_rig.dataset import Dataset
from needle_rig.units import rad
from needle_rig.workbench.estimation.baseline import Baseline
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.observations.noise import covariance
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.unmodelled_outliers import outlying_bins, without_outliers
from needle_rig.workbench.virtual.noise import Noise
from tests.workbench.hidden import dataset, effect, few, null_fit

CHANNEL, TRIAL = 4, 1
TOLD = 12
"""Outliers that medians told in the channel."""


@functools.cache
def clean() -> Baseline:
    return null_fit()


def off(sigmas: dict[int, float], told: int = TOLD) -> tuple[Problem, Fit]:
    """The problem with some moving bins of one channel of one trial off by so much, and its fit."""
    problem, found = clean().problem, clean().current
    use, stated = covariance(problem.noise, problem.trials[TRIAL], CHANNEL)
    sd = dict(zip(use.tolist(), np.sqrt(np.diag(stated)).tolist(), strict=True))
    raw = problem.raw(found.residuals)[TRIAL]
    change = np.zeros(raw.shape)
    for place, size in sigmas.items():
        change[CHANNEL, place] = size * sd[place] - raw[CHANNEL, place]
    residuals = list(found.residuals)
    residuals[TRIAL] = residuals[TRIAL] + problem.whiteners[TRIAL](change)
    trials = [
        dataclasses.replace(b, outliers=(*b.outliers[:CHANNEL], told if t == 0 else 0))
        for t, b in enumerate(problem.trials)
    ]
    return dataclasses.replace(problem, trials=tuple(trials)), dataclasses.replace(
        found, residuals=tuple(residuals)
    )


def places(given: tuple[Problem, Fit]) -> list[int]:
    """Bins of the channel that are told; no other is."""
    bins = outlying_bins(*given)
    found = np.flatnonzero(bins[TRIAL][CHANNEL]).tolist()
    assert sum(int(b.sum()) for b in bins) == len(found)
    return found


@pytest.mark.parametrize(("sigmas", "outlier"), [(-6.1, True), (5.9, False)])
def test_a_moving_bin_far_beyond_the_noise_holds_an_outlier(sigmas: float, outlier: bool) -> None:
    assert places(off({6: sigmas, 5: 0.0, 7: 0.0})) == [6] * outlier


@pytest.mark.parametrize(("beside", "outlier"), [(4.7, True), (5.3, False)])
def test_what_the_bins_beside_it_show_too_is_no_outlier(beside: float, outlier: bool) -> None:
    assert places(off({5: 0.0, 6: 10.0, 7: beside})) == [6] * outlier
    assert places(off({5: beside, 6: 10.0, 7: 0.0})) == [6] * outlier


def test_at_rest_the_median_tells() -> None:
    problem = clean().problem
    held = int(np.flatnonzero(~problem.trials[TRIAL].moving)[3])
    assert places(off({held: 20.0})) == []


@pytest.mark.parametrize(
    ("told", "number", "outliers"), [(0, 1, False), (1, 3, True), (1, 4, False), (2, 4, True), (2, 5, False)]
)
def test_they_are_no_more_than_the_channel_s_share_of_outliers_lets_expect(
    told: int, number: int, outliers: bool
) -> None:
    """A third of the samples is of a base that moves: 0.34 are expected there with one told, 0.68 with two.

    Chances of as many: 0.005, 0.0004, 0.005, 0.0007.
    """
    trials = clean().problem.trials
    moving = sum(float(b.count[CHANNEL][b.moving].sum()) for b in trials)
    every = sum(float(b.count[CHANNEL].sum()) for b in trials)
    assert moving / every == pytest.approx(0.34, abs=0.01)
    bins = [4, 7, 10, 13, 16][:number]
    sigmas = {k: 12.0 * (k in bins) for k in range(3, 17)}
    assert places(off(sigmas, told)) == (bins if outliers else [])


def test_without_outliers_there_is_nothing_to_leave_out() -> None:
    assert without_outliers(clean(), clean().problem, clean().current) is None


@functools.cache
def by_camera() -> Dataset:
    """Elastic tissue, seen by a camera at a fifth of the rate that is 2 to 6° off at times."""
    data = dataset(effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.3), noise=Noise())
    random = np.random.default_rng(3)
    trials = []
    for given in data.trials:
        hall = np.full_like(given.hall_rad, np.nan)
        hall[::5, 3] = given.hall_rad[::5, 3]
        wrong = 5 * random.choice(len(hall) // 5, 5, replace=False)
        hall[wrong, 3] += rad(random.choice([-1.0, 1.0], 5) * random.uniform(2.0, 6.0, 5))
        trials.append(dataclasses.replace(given, hall_rad=hall))
    return dataclasses.replace(data, trials=tuple(trials))


@pytest.mark.whole
def test_what_is_missing_is_named_beside_a_camera_that_sees_wrong_at_times() -> None:
    found = diagnose(by_camera(), few("tissue_elasticity", "tip_friction", "torque_bias"))
    assert found.effects == ("tissue_elasticity",)
    assert found.held_out_error_after < 1.1
    assert any("Left out as outliers" in note and "hall_4_deg" in note for note in found.notes)
