"""The spread of a fit along the valley of a form parameter, where curvature says nothing of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from needle_rig.numerics import Array
from needle_rig.workbench.estimation import profile
from needle_rig.workbench.estimation.baseline import as_baseline
from needle_rig.workbench.estimation.parameters import scaled_values_of
from needle_rig.workbench.estimation.problem import EXACT, Fit, ParameterVector, Problem
from needle_rig.workbench.estimation.profile import over_profiles
from tests.workbench.hidden import effect, fit, null_fit

GROWTH, REST_TIME = 0.2, 1.0
Held = Callable[..., Fit]


def ageing(seed: int = 1) -> tuple[Problem, Fit]:
    """(problem, fit of the hidden effect from its true values)."""
    hidden = effect("stiction_ageing", growth_per_decade=GROWTH, rest_time_s=REST_TIME)
    baseline = null_fit(hidden, seed=seed, library=("stiction_ageing",))
    at = scaled_values_of(baseline.problem.parameters(["stiction_ageing"]), [hidden])
    start = dataclasses.replace(baseline.current.vector, scaled_values=at)
    return baseline.problem, fit(baseline.problem, ["stiction_ageing"], start)


def gaussian(found: Fit, covariance: Array) -> Held:
    """What `fit` gives where the posterior is normal about `found`: that, or the best with the form held."""

    def held(problem: Problem, _: Sequence[str], start: ParameterVector, **__: object) -> Fit:
        if not problem.fixed:
            return found
        off = start.scaled_values[1] - found.vector.scaled_values[1]
        move = covariance[:, 3] / covariance[3, 3] * off
        vector = dataclasses.replace(
            found.vector,
            log_friction=found.vector.log_friction + move[0],
            log_rigidity=found.vector.log_rigidity + move[1],
            scaled_values=found.vector.scaled_values + move[2:],
        )
        risen = found.objective + off**2 / covariance[3, 3]
        return dataclasses.replace(found, vector=vector, objective=float(risen))

    return held


@pytest.mark.parametrize("spread", [0.004, 0.04, 0.4])
def test_a_profile_gives_the_covariance_of_a_normal_posterior(
    monkeypatch: pytest.MonkeyPatch, spread: float
) -> None:
    problem, found = ageing()
    valley = np.array([0.01, 0.002, 1.5, 1.0]) * spread
    true = np.outer(valley, valley) + np.diag([1e-4, 1e-5, 0.1, 0.0]) ** 2
    told = np.diag([1e-4, 1e-5, 0.1, 0.1 * spread]) ** 2
    found = dataclasses.replace(found, covariance=told)
    monkeypatch.setattr(profile, "fit", gaussian(found, true))
    again = over_profiles(problem, found)
    assert np.sqrt(np.diag(again.covariance)) == pytest.approx(np.sqrt(np.diag(true)), rel=0.1)
    slope = again.covariance[2, 3] / np.sqrt(again.covariance[2, 2] * again.covariance[3, 3])
    assert slope == pytest.approx(true[2, 3] / np.sqrt(true[2, 2] * true[3, 3]), abs=0.03)
    assert np.all(np.linalg.eigvalsh(again.covariance) > -1e-12)


def test_a_form_that_the_data_hold_at_once_keeps_the_spread_of_the_fit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, found = ageing()
    found = dataclasses.replace(found, covariance=np.eye(4) * 0.09)
    monkeypatch.setattr(profile, "fit", gaussian(found, np.eye(4) * 1e-6))
    assert over_profiles(problem, found) is found


def test_a_lower_point_of_a_profile_is_gone_on_from(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, found = ageing()
    monkeypatch.setattr(profile, "fit", gaussian(found, np.diag([1e-4, 1e-5, 0.1, 0.05]) ** 2))
    form = found.vector.scaled_values + np.array([0.0, 0.1])
    vector = dataclasses.replace(found.vector, scaled_values=form)
    aside = dataclasses.replace(found, vector=vector, objective=found.objective + 4.0)
    again = over_profiles(problem, aside)
    assert again.vector is found.vector
    assert again.scaled_errors[1] == pytest.approx(0.05, rel=0.2)


def test_an_effect_without_a_form_keeps_its_fit() -> None:
    baseline = null_fit()
    assert over_profiles(baseline.problem, baseline.current) is baseline.current


@pytest.mark.whole
def test_a_parameter_that_is_held_stays_and_others_are_fitted() -> None:
    problem, found = ageing()
    start = dataclasses.replace(found.vector, scaled_values=found.vector.scaled_values + np.array([0.0, 0.1]))
    name = found.parameters[1].full_name
    held = fit(problem.fixing({name: start.scaled_values[1]}), ["stiction_ageing"], start)
    # it is known to what stands for exact, and the fit beside it to what the data tell
    assert held.scaled_errors[1] < 1.1 * EXACT < 0.1 * found.scaled_errors[1]
    assert held.vector.scaled_values[1] == start.scaled_values[1]
    assert held.vector.scaled_values[0] > found.vector.scaled_values[0] + 0.05
    assert found.objective - 1.0 < held.objective
    free = fit(problem, ["stiction_ageing"], start)
    assert free.vector.scaled_values[1] != start.scaled_values[1]


@pytest.mark.long
@pytest.mark.parametrize("seed", range(61, 67))
def test_the_interval_of_ageing_holds_the_truth(seed: int) -> None:
    """Curvature alone, or a path of blocks, held it in one of two."""
    hidden = effect("stiction_ageing", growth_per_decade=GROWTH, rest_time_s=REST_TIME)
    baseline = null_fit(hidden, seed=seed, library=("stiction_ageing",))
    at = scaled_values_of(baseline.problem.parameters(["stiction_ageing"]), [hidden])
    start = dataclasses.replace(baseline.current.vector, scaled_values=at - np.array([0.2, 0.15]))
    coarse = fit(baseline.problem, ["stiction_ageing"], start)
    found = as_baseline(baseline, baseline.problem, coarse, None)[1]
    assert np.all(np.abs(found.vector.scaled_values - at) < 2.5 * found.scaled_errors)
    assert found.scaled_errors[0] < 0.25
