"""Maximum a posteriori fits: Levenberg–Marquardt steps with Broyden updates, within bounds.

Dry friction makes the objective jagged: a step that raises it is never accepted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.posterior import Objective, excess, sum_of_squares
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem

OBJECTIVE_TOLERANCE = 0.05
"""A fit ends when the next step would lower the objective by less than this."""
EXCESS_TOLERANCE = 2e-3
"""A fit also ends when the next step would lower the objective by less than this share of its excess over the
noise: a fit that misses by far need not be exact."""
ROUGH = 0.5
"""The same of a first fit: below the price of a parameter, ln 5 at least."""

FIRST_DAMPING, LEAST_DAMPING, LOWER, HIGHER = 1e-3, 1e-6, 0.2, 8.0
"""Marquardt's damping relative to the curvature, and its factors after a good step and after a bad one."""
MOST_DAMPINGS = 7
"""Dampings that are tried on one set of derivatives: the last is two million times the first."""
SECANT_SHARE = 0.7
"""Share of the expected fall from which derivatives are updated by the step instead of computed afresh."""
TRUSTED_SHARE = 0.5
"""Share of the expected fall from which damping is lowered."""
NO_STEP = 1e-16
"""Square of a step that is none but for rounding: it tells nothing of derivatives."""
MOST_BOUNDS = 4
"""Changes of the active set in one step."""


def fit(
    problem: Problem,
    effects: Sequence[str],
    start: ParameterVector,
    *,
    nuisance: Array | None = None,
    jacobians: Sequence[Array] | None = None,
    iterations: int = 25,
    tolerance: float = OBJECTIVE_TOLERANCE,
) -> Fit | None:
    """The nearest minimum from `start`, or None where the model cannot be solved at `start`.

    `jacobians` are the derivatives there, of a fit that is gone on with. What the problem fixes stays.
    """
    parameters = problem.parameters(effects)
    objective = Objective(problem, parameters, start.scaled_values)
    x = objective.packed(
        start, nuisance if nuisance is not None and nuisance.size == objective.q else np.zeros(objective.q)
    )
    residuals = objective.residuals(x)
    if residuals is None:
        return None
    value = sum_of_squares(residuals) + objective.prior(x)
    columns = objective.p + (objective.random_effect_column == objective.p)
    known = None if jacobians is None else [j[:, :columns] for j in jacobians]
    damping, converged, fresh = FIRST_DAMPING, False, known is not None
    for _ in range(iterations):
        if known is None:
            known = objective.derivatives(x, residuals)
            fresh = True
            if known is None:
                return None
        linear = LinearisedFit.at(
            problem, parameters, x, residuals, known, objective.random_effect_precision(x)
        )
        curvature, descent = linear.curvature + linear.level, linear.descent
        enough = tolerance + EXCESS_TOLERANCE * excess(problem, value)
        improved = refused = False
        for _ in range(MOST_DAMPINGS):
            step, expected = _damped(objective, x, curvature, descent, damping)
            while expected < enough and not refused and damping > LEAST_DAMPING:
                # damping holds back what the data hardly determine first
                damping = max(damping * LOWER, LEAST_DAMPING)
                step, expected = _damped(objective, x, curvature, descent, damping)
            if expected < enough:
                converged = True
                break
            after = np.clip(x + step, objective.low, objective.high)
            after_residuals = objective.residuals(after)
            after_value = (
                np.inf
                if after_residuals is None
                else sum_of_squares(after_residuals) + objective.prior(after)
            )
            if after_residuals is not None and after_value < value:
                gained = value - after_value
                known = (
                    _updated(objective, known, x, after, residuals, after_residuals)
                    if gained > SECANT_SHARE * expected
                    else None
                )
                damping = (
                    max(damping * LOWER, LEAST_DAMPING) if gained > TRUSTED_SHARE * expected else damping
                )
                x, residuals, value = after, after_residuals, after_value
                improved, fresh = True, False
                break
            damping, refused = max(damping * HIGHER, FIRST_DAMPING), True
        if converged and not fresh:
            converged, known = False, None
            continue
        if converged:
            break
        if not improved:
            if fresh:
                break
            known = None
    if known is None or not fresh:
        known = objective.derivatives(x, residuals)
        if known is None:
            return None
    return _finish(objective, tuple(effects), x, residuals, value, known, converged)


def _damped(
    objective: Objective, x: Array, curvature: Array, descent: Array, damping: float
) -> tuple[Array, float]:
    """A damped step within bounds, and the fall of the objective that it promises."""
    step = _bounded_step(objective, x, curvature, descent, damping)
    return step, float(2 * descent @ step - step @ curvature @ step)


def _bounded_step(objective: Objective, x: Array, curvature: Array, descent: Array, damping: float) -> Array:
    """Damped step within bounds: an active set of parameters stays at the bounds that the step would
    cross."""
    free = np.ones(x.size, bool)
    step = np.zeros(x.size)
    for _ in range(MOST_BOUNDS):
        damped = curvature + damping * np.diag(np.diag(curvature) + 1e-9)
        step[:] = np.where(free, 0.0, step)
        active = ~free
        right = descent[free] - curvature[np.ix_(free, active)] @ step[active]
        step[free] = np.linalg.solve(damped[np.ix_(free, free)], right)
        out = free & ((x + step > objective.high) | (x + step < objective.low))
        if not out.any():
            break
        step[out] = np.clip(x[out] + step[out], objective.low[out], objective.high[out]) - x[out]
        free &= ~out
    return np.asarray(np.clip(x + step, objective.low, objective.high) - x)


def _updated(
    objective: Objective,
    jacobians: list[Array],
    x: Array,
    after: Array,
    residuals: list[Array],
    after_residuals: list[Array],
) -> list[Array]:
    """Broyden's rank-one update of each trial's derivatives by an accepted step."""
    move = (after - x)[: objective.p]
    updated = []
    for t, jacobian in enumerate(jacobians):
        step = np.zeros(jacobian.shape[1])
        step[: objective.p] = move
        step[objective.random_effect_column] += after[objective.p + t] - x[objective.p + t]
        size = step @ step
        change = (
            residuals[t]
            - after_residuals[t]
            - objective.problem.nuisance[t] @ (after - x)[objective.p + objective.trials :]
        )
        updated.append(
            jacobian + np.outer(change - jacobian @ step, step) / size if size > NO_STEP else jacobian
        )
    return updated


def _finish(
    objective: Objective,
    effects: tuple[str, ...],
    x: Array,
    residuals: list[Array],
    value: float,
    jacobians: list[Array],
    converged: bool,
) -> Fit:
    problem, p, trials = objective.problem, objective.p, objective.trials
    noise = problem.noise
    linear = LinearisedFit.at(
        problem, objective.parameters, x, residuals, jacobians, objective.random_effect_precision(x)
    )
    seen = np.bincount(objective.recorded, [t.random_effect @ t.random_effect for t in linear.trials])
    log_det = np.log1p(seen * noise.scatter**2)
    return Fit(
        effects=effects,
        parameters=objective.parameters,
        vector=objective.unpacked(x.copy()),
        nuisance=x[p + trials :].copy(),
        objective=value + float(log_det.sum()),
        chi2=sum_of_squares(residuals),
        pull_rigidity=float((x[1] - objective.stated) / problem.rigidity_prior),
        scatter=objective.random_effect_precision(x) ** -0.5,
        scatter_dof=noise.scatter_dof + seen.size,
        covariance=linear.covariance,
        residuals=tuple(residuals),
        jacobians=tuple(t.columns[:, : p + 1] for t in linear.trials),
        rank=linear.rank,
        converged=converged,
    )
