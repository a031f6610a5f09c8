"""Fits of all parameters at once, in whitened units, for an objective that dry friction makes jagged.

Steps are damped and never accepted when they make the fit worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.parameters import Coordinate
from needle_rig.workbench.estimation.posterior import Objective, excess, sum_of_squares
from needle_rig.workbench.estimation.problem import Point, Problem

ENOUGH = 0.05
"""A fit ends when the next step would lower the objective by less than this,"""
LOOSE = 2e-3
"""or by less than this share of what it is above the noise: a fit that misses by far need not be exact."""


@dataclass(frozen=True)
class Fit:
    """A minimum. T trials, p global parameters (friction, rigidity, then k positions), q nuisances."""

    effects: tuple[str, ...]
    axes: tuple[Coordinate, ...]
    point: Point
    nuisance: Array
    objective: float
    """−2 log posterior with its log-determinants, up to a constant shared by all fits of a problem."""
    chi2: float
    """Sum of squared whitened residuals."""
    trial_loss: Array
    """Share of each trial in the objective (T,)."""
    pull_rigidity: float
    """Rigidity's distance from its stated value in prior standard deviations."""
    scatter: float
    """Relative scatter of friction from trial to trial that this fit sees,"""
    scatter_dof: float
    """and its degrees of freedom, those of its prior included."""
    covariance: Array
    """Of the global parameters (p, p), all others marginalised."""
    residuals: tuple[Array, ...]
    jacobians: tuple[Array, ...]
    """Derivatives of the whitened model (n, p + 1) a trial; the last column is the trial's own friction."""
    rank: int
    """How many directions the effects' positions span that the other parameters do not."""
    converged: bool

    @property
    def position_error(self) -> Array:
        """Standard deviation of each position (k,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance)[2:], 0.0))


def fit(
    problem: Problem,
    effects: Sequence[str],
    start: Point,
    *,
    nuisance: Array | None = None,
    iterations: int = 25,
    enough: float = ENOUGH,
) -> Fit | None:
    """The nearest minimum from `start`, or None where the model cannot be solved at `start`."""
    axes = problem.axes(effects)
    state = Objective(problem, axes)
    x = state.vector(
        start, nuisance if nuisance is not None and nuisance.size == state.q else np.zeros(state.q)
    )
    rows = state.rows(x)
    if rows is None:
        return None
    value = sum_of_squares(rows) + state.prior(x)
    damping, jacobians, converged, fresh = 1e-3, None, False, False
    for _ in range(iterations):
        if jacobians is None:
            jacobians = state.derivatives(x, rows)
            fresh = True
            if jacobians is None:
                return None
        linear = LinearisedFit.at(problem, axes, x, rows, jacobians, state.own_precision(x))
        curvature, descent = linear.curvature + linear.level, linear.descent
        improved = False
        for _ in range(7):
            step = _bounded_step(state, x, curvature, descent, damping)
            expected = float(2 * descent @ step - step @ curvature @ step)
            if expected < enough + LOOSE * excess(problem, value):
                converged = True
                break
            after = np.clip(x + step, state.low, state.high)
            after_rows = state.rows(after)
            after_value = np.inf if after_rows is None else sum_of_squares(after_rows) + state.prior(after)
            if after_rows is not None and after_value < value:
                gained = value - after_value
                jacobians = (
                    _updated(state, jacobians, x, after, rows, after_rows)
                    if gained > 0.7 * expected
                    else None
                )
                damping = max(damping * 0.2, 1e-6) if gained > 0.5 * expected else damping
                x, rows, value = after, after_rows, after_value
                improved, fresh = True, False
                break
            damping = max(damping * 8, 1e-3)
        if converged and not fresh:
            converged, jacobians = False, None
            continue
        if converged:
            break
        if not improved:
            if fresh:
                break
            jacobians = None
    if jacobians is None or not fresh:
        jacobians = state.derivatives(x, rows)
        if jacobians is None:
            return None
    return _finish(state, tuple(effects), x, rows, value, jacobians, converged)


def _bounded_step(state: Objective, x: Array, curvature: Array, descent: Array, damping: float) -> Array:
    """Damped step that stays within bounds: parameters that run into one are held there."""
    free = np.ones(x.size, bool)
    step = np.zeros(x.size)
    for _ in range(4):
        damped = curvature + damping * np.diag(np.diag(curvature) + 1e-9)
        step[:] = np.where(free, 0.0, step)
        held = ~free
        right = descent[free] - curvature[np.ix_(free, held)] @ step[held]
        step[free] = np.linalg.solve(damped[np.ix_(free, free)], right)
        out = free & ((x + step > state.high) | (x + step < state.low))
        if not out.any():
            break
        step[out] = np.clip(x[out] + step[out], state.low[out], state.high[out]) - x[out]
        free &= ~out
    return np.asarray(np.clip(x + step, state.low, state.high) - x)


def _updated(
    state: Objective,
    jacobians: list[Array],
    x: Array,
    after: Array,
    rows: list[Array],
    after_rows: list[Array],
) -> list[Array]:
    """Broyden's update of each trial's derivatives from a step that was taken anyway."""
    move = (after - x)[: state.p]
    updated = []
    for t, jacobian in enumerate(jacobians):
        own = np.zeros(jacobian.shape[1])
        own[: state.p] = move
        own[state.own] += after[state.p + t] - x[state.p + t]
        size = own @ own
        change = rows[t] - after_rows[t] - state.problem.nuisance[t] @ (after - x)[state.p + state.trials :]
        updated.append(jacobian + np.outer(change - jacobian @ own, own) / size if size > 1e-16 else jacobian)
    return updated


def _finish(
    state: Objective,
    effects: tuple[str, ...],
    x: Array,
    rows: list[Array],
    value: float,
    jacobians: list[Array],
    converged: bool,
) -> Fit:
    problem, p, trials = state.problem, state.p, state.trials
    noise = problem.noise
    linear = LinearisedFit.at(problem, state.axes, x, rows, jacobians, state.own_precision(x))
    own = x[p : p + trials]
    room = noise.scatter_dof * noise.scatter**2
    log_det = np.array([np.log1p(t.own @ t.own * noise.scatter**2) for t in linear.trials])
    share = np.log1p((own**2).sum() / room) * (noise.scatter_dof + trials)
    part = own**2 / max((own**2).sum(), 1e-30)
    loss = np.array([r @ r for r in rows]) + log_det + share * part
    return Fit(
        effects=effects,
        axes=state.axes,
        point=state.point(x.copy()),
        nuisance=x[p + trials :].copy(),
        objective=value + float(log_det.sum()),
        chi2=sum_of_squares(rows),
        trial_loss=loss,
        pull_rigidity=float((x[1] - state.stated) / problem.rigidity_prior),
        scatter=state.own_precision(x) ** -0.5,
        scatter_dof=noise.scatter_dof + trials,
        covariance=linear.covariance,
        residuals=tuple(rows),
        jacobians=tuple(t.columns[:, : p + 1] for t in linear.trials),
        rank=linear.rank,
        converged=converged,
    )
