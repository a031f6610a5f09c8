import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import chdtrc

from needle_rig.workbench.estimation.cross_validation import CrossValidation, cross_validate
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.selection.evidence import gain_of, improves_cross_validation
from tests.workbench.hidden import null_fit


@pytest.mark.parametrize(("pull_sigmas", "more"), [(0.0, 0.0), (2.0, 4.0), (5.0, 25.0)])
def test_a_rigidity_far_from_the_stated_one_is_a_prediction_that_failed(
    pull_sigmas: float, more: float
) -> None:
    baseline = null_fit(seed=21)
    problem, found = baseline.problem, baseline.current
    near, far = (
        cross_validate(problem, dataclasses.replace(found, pull_rigidity=pull)) for pull in (0.0, pull_sigmas)
    )
    _, spread = LinearisedFit.of(problem, found).without(())
    leverage = spread[1, 1] / problem.rigidity_prior**2
    assert 0.0 < leverage < 0.1
    assert far.loss - near.loss == pytest.approx(more / (1.0 - leverage), rel=1e-6, abs=1e-9)
    assert far.error == near.error
    assert improves_cross_validation(far, near) is (more > 0.0)


def test_nothing_is_predicted_where_nothing_was_left_out() -> None:
    assert not improves_cross_validation(None, CrossValidation(1.0, 1.0, ()))


TRIALS = 8
PRIOR = 4.0 * 0.025**2
"""Sum of squares that the prior scatter is worth."""


def with_friction(log_friction: np.ndarray, rank: int) -> Any:
    """A fit of which nothing but the trials' friction is told."""
    dof = 4.0 + TRIALS
    scatter = float(np.sqrt((PRIOR + log_friction @ log_friction) / dof))
    return SimpleNamespace(
        vector=SimpleNamespace(trial_friction=log_friction),
        scatter=scatter,
        scatter_dof=dof,
        rank=rank,
        objective=2.0 * dof * float(np.log(scatter)),
    )


def fits_of(log_friction: np.ndarray) -> tuple[Any, Any]:
    """A fit without and one with an effect that takes the trials' trend."""
    course = np.arange(TRIALS) - (TRIALS - 1) / 2
    log_friction = log_friction - log_friction.mean()
    left = log_friction - course * (course @ log_friction) / (course @ course)
    return with_friction(log_friction, 0), with_friction(left, 1)


def p_of_trend(log_friction: np.ndarray) -> float:
    """p of an effect that takes the trials' trend."""
    return float(chdtrc(1, gain_of(*fits_of(log_friction))))


@pytest.mark.parametrize("scatter", [0.01, 0.05, 0.2])
def test_chance_makes_a_trend_of_friction_no_more_often_than_is_said(scatter: float) -> None:
    random = np.random.default_rng(1)
    drawn = [p_of_trend(scatter * random.standard_normal(TRIALS)) for _ in range(4000)]
    assert np.mean(np.less(drawn, 0.01)) < 0.01 + 3 * np.sqrt(0.01 / 4000)


def test_a_likelihood_ratio_alone_finds_trends_that_chance_makes() -> None:
    """What the F test of steadier friction is worth."""
    random = np.random.default_rng(1)
    found = list[float]()
    for _ in range(4000):
        log_friction = 0.05 * random.standard_normal(TRIALS)
        parent, child = fits_of(log_friction)
        found.append(chdtrc(1, max(parent.objective - child.objective, 0.0)))
    assert np.mean(np.less(found, 0.01)) > 0.03


def test_a_trend_far_beyond_the_trials_own_scatter_is_seen_though_friction_may_scatter_more() -> None:
    # 11 % from first to last, 0.4 % beside it: the prior of 2.5 % once hid it
    random = np.random.default_rng(2)
    log_friction = np.linspace(0.055, -0.055, TRIALS) + 0.004 * random.standard_normal(TRIALS)
    assert p_of_trend(log_friction) < 1e-4
