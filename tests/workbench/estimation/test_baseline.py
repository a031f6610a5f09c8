import dataclasses

import numpy as np
import pytest

from needle_rig.units import rad
from needle_rig.workbench.estimation.baseline import Baseline, with_noise_at
from needle_rig.workbench.estimation.discretisation_error import refitted
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.observations.noise_terms.drift import Drift
from tests.workbench.hidden import null_fit

WANDERS_DEG, WANDERS_S = 0.15, 2.0
SET_ASIDE_DEG = 1.5


@pytest.fixture(scope="module", params=[41, 42, 43])
def beside_one_set_aside(request: pytest.FixtureRequest) -> tuple[Baseline, Problem, Fit]:
    """Data of the baseline's model with Hall angles that wander, and what an effect set aside does to them:
    the baseline, the problem with that as a nuisance, and the fit to it."""
    baseline = null_fit(seed=request.param)
    problem, random = baseline.problem, np.random.default_rng(request.param)
    drift = Drift(np.r_[0.0, np.full(4, rad(WANDERS_DEG))], np.full(5, WANDERS_S))
    wandering = problem.with_noise(dataclasses.replace(problem.noise, shown=(drift,)))
    drawn = wandering.raw([random.standard_normal(w.channel.size) for w in wandering.whiteners])
    known = problem.predict(baseline.current.parameters, baseline.current.vector)
    shapes = []
    for b in problem.trials:
        shape = np.zeros_like(b.mean)
        shape[1:] = rad(SET_ASIDE_DEG) * np.cos(4.0 * b.base_rad)
        shapes.append(shape)
    held = problem.with_means([m + s + d for m, s, d in zip(known, shapes, drawn, strict=True)])
    directions = zip(held.nuisance, held.whiteners, shapes, strict=True)
    beside = dataclasses.replace(held, nuisance=tuple(np.column_stack([n, w(s)]) for n, w, s in directions))
    start = dataclasses.replace(baseline.current, nuisance=np.append(baseline.current.nuisance, 0.0))
    return dataclasses.replace(baseline, problem=held), beside, refitted(beside, start)


def test_noise_is_told_from_what_is_left_beside_an_effect_set_aside(
    beside_one_set_aside: tuple[Baseline, Problem, Fit],
) -> None:
    """What replicates share of it must not pass for a wrong model, of which nothing is taken for noise."""
    baseline, problem, found = beside_one_set_aside
    assert found.nuisance[-1] == pytest.approx(1.0, abs=0.3)
    noise = with_noise_at(baseline, problem, found).problem.noise
    (drift,) = noise.shown
    rate = drift.sd[1:] ** 2 / drift.form[1:]
    assert np.all(rate > 0.3 * rad(WANDERS_DEG) ** 2 / WANDERS_S)
    assert np.all(rate < 6.0 * rad(WANDERS_DEG) ** 2 / WANDERS_S)


def test_residuals_in_bins_are_data_minus_model_minus_nuisances(
    beside_one_set_aside: tuple[Baseline, Problem, Fit],
) -> None:
    _, problem, found = beside_one_set_aside
    readings = problem.predict(found.parameters, found.vector)
    left = problem.raw(found.residuals)
    given = zip(problem.trials, readings, problem.whiteners, problem.nuisance, left, strict=True)
    for b, model, whitened, directions, own in given:
        assert np.array_equal(np.isfinite(own), np.isfinite(b.mean))
        assert whitened(own) == pytest.approx(whitened(b.mean - model) - directions @ found.nuisance)
