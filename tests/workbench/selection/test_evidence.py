import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import chdtrc

from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.selection.evidence import gain_of, improves_cross_validation
from tests.workbench.hidden import null_fit


@pytest.mark.parametrize(
    ("loss", "error", "relieved_sigmas", "speaks_for"),
    [
        (99.0, 1.20, 0.0, True),
        (101.0, 1.20, 0.0, False),
        (101.0, 1.20, 2.9, False),
        (101.0, 1.20, 3.1, True),
        (101.0, 1.20 * 1.0201, 3.1, False),
    ],
)
def test_the_needle_s_constants_stand_in_for_commands_left_out_but_not_against_them(
    loss: float, error: float, relieved_sigmas: float, speaks_for: bool
) -> None:
    child = null_fit(seed=21).current
    child = dataclasses.replace(child, pull_rigidity=0.0)
    parent = dataclasses.replace(child, pull_rigidity=relieved_sigmas)
    assert (
        improves_cross_validation(
            parent, CrossValidation(1.20, 100.0, ()), child, CrossValidation(error, loss, ())
        )
        is speaks_for
    )


def test_nothing_is_predicted_where_nothing_was_left_out() -> None:
    found = null_fit(seed=21).current
    parent = dataclasses.replace(found, pull_rigidity=5.0)
    child = dataclasses.replace(found, pull_rigidity=0.0)
    assert not improves_cross_validation(parent, None, child, CrossValidation(1.0, 1.0, ()))


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


def p_of_trend(log_friction: np.ndarray) -> float:
    """p of an effect that takes the trials' trend."""
    course = np.arange(TRIALS) - (TRIALS - 1) / 2
    log_friction = log_friction - log_friction.mean()
    left = log_friction - course * (course @ log_friction) / (course @ course)
    return float(chdtrc(1, gain_of(with_friction(log_friction, 0), with_friction(left, 1))))


@pytest.mark.parametrize("scatter", [0.01, 0.05, 0.2])
def test_chance_makes_a_trend_of_friction_no_more_often_than_is_said(scatter: float) -> None:
    random = np.random.default_rng(1)
    drawn = [p_of_trend(scatter * random.standard_normal(TRIALS)) for _ in range(4000)]
    assert np.mean(np.less(drawn, 0.01)) < 0.01 + 3 * np.sqrt(0.01 / 4000)


def test_a_trend_far_beyond_the_trials_own_scatter_is_seen_though_friction_may_scatter_more() -> None:
    # 11 % from first to last, 0.4 % beside it: the prior of 2.5 % once hid it
    random = np.random.default_rng(2)
    log_friction = np.linspace(0.055, -0.055, TRIALS) + 0.004 * random.standard_normal(TRIALS)
    assert p_of_trend(log_friction) < 1e-4
