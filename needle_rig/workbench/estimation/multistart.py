"""Searches among the minima of a jagged objective: valleys that bend, shapes that lie close together."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.map_fit import ENOUGH, Fit, fit
from needle_rig.workbench.estimation.posterior import Objective, excess, sum_of_squares
from needle_rig.workbench.estimation.problem import Point, Problem

MOST_WALKS = 4
"""How often a fit goes on from a lower place along its least certain direction."""
SHAPE_STEPS = (0.3, -0.3)
"""How far from a fit's own shape others are tried, in positions: a factor of two on a decade's axis;"""
FINE_SHAPE_STEPS = (0.1, -0.1)
"""nearer ones that are tried, too, where minima lie close together."""


def through_valleys(problem: Problem, found: Fit) -> Fit:
    """A fit, or the one that goes on from lower places along the direction that the data hardly see.

    There the objective falls by less than its derivatives err, and a fit stops far from its minimum with a
    spread that knows nothing of it. A valley that bends, as one of shapes does, is left by straight walks:
    what is still above the noise is fitted again from other shapes.
    """
    for _ in range(MOST_WALKS):
        lower = _along_valley(problem, found)
        if lower is None:
            break
        again = fit(problem, found.effects, lower[0], nuisance=lower[1])
        if again is None or again.objective >= found.objective - ENOUGH:
            break
        found = again
    return over_shapes(problem, found) if excess(problem, found.objective) > 0.0 else found


def over_shapes(problem: Problem, found: Fit, steps: Sequence[float] = SHAPE_STEPS) -> Fit:
    """A fit, or a lower one from other shapes of its last effect, as long as that helps.

    Its covariance is that over all the minima met, each as likely as its objective says.
    """
    met = [found]
    for _ in range(MOST_WALKS):
        further = _from_other_shapes(problem, found, steps)
        met += further
        again = min(further, key=lambda f: f.objective, default=found)
        if again.objective > found.objective - 1.0:
            break
        found = again
    found = min(met, key=lambda f: f.objective)
    return dataclasses.replace(found, covariance=_over_minima(found, met))


def _over_minima(lowest: Fit, met: Sequence[Fit]) -> Array:
    """Covariance (p, p) about the lowest of several minima; one met twice counts once."""
    at = [np.r_[f.point.log_friction, f.point.log_rigidity, f.point.positions] for f in met]
    centre = np.r_[lowest.point.log_friction, lowest.point.log_rigidity, lowest.point.positions]
    near = np.sqrt(np.maximum(np.diag(lowest.covariance), 1e-18))
    kept: list[int] = []
    for i in sorted(range(len(met)), key=lambda i: met[i].objective):
        if all(np.any(np.abs(at[i] - at[k]) > near) for k in kept):
            kept.append(i)
    weights = np.exp([0.5 * (lowest.objective - met[i].objective) for i in kept])
    parts = [
        w * (met[i].covariance + np.outer(at[i] - centre, at[i] - centre))
        for w, i in zip(weights, kept, strict=True)
    ]
    return np.asarray(sum(parts) / weights.sum(), dtype=np.float64)


def _from_other_shapes(problem: Problem, found: Fit, steps: Sequence[float]) -> list[Fit]:
    fits = []
    for i, axis in enumerate(found.axes):
        if axis.info.shapes and axis.effect == found.effects[-1]:
            for step in steps:
                positions = found.point.positions.copy()
                positions[i] += step
                start = dataclasses.replace(found.point, positions=positions)
                fits.append(fit(problem, found.effects, start, nuisance=found.nuisance))
    return [f for f in fits if f is not None]


def _along_valley(problem: Problem, found: Fit) -> tuple[Point, Array] | None:
    """The lowest place on the least certain direction of a fit if it is lower than the fit, else None.

    All other parameters follow as the fit's derivatives say: the trials' own friction, too.
    """
    state = Objective(problem, found.axes)
    at = state.vector(found.point, found.nuisance)
    move = LinearisedFit.of(problem, found).loosest()
    if move is None:
        return None
    lowest, lower = found.chi2 + state.prior(at) - ENOUGH, None
    for sigmas in (3.0, -3.0, 10.0, -10.0, 30.0, -30.0, 100.0, -100.0):
        moved = np.clip(at + sigmas * move, state.low, state.high)
        rows = state.rows(moved)
        value = np.inf if rows is None else sum_of_squares(rows) + state.prior(moved)
        if value < lowest:
            lowest, lower = value, moved
    return None if lower is None else (state.point(lower), lower[state.p + state.trials :])


def fit_without_derivatives(
    problem: Problem, effects: Sequence[str], start: Point, evaluations: int = 200
) -> Fit | None:
    """A simplex search over friction, rigidity and positions, then the usual fit from where it ended."""
    axes = problem.axes(effects)
    state = Objective(problem, axes)
    x = state.vector(start, np.zeros(state.q))
    scale = np.r_[0.1, 0.02, np.full(state.k, 0.3)]

    def objective(moved: Array) -> float:
        full = x.copy()
        full[: state.p] = np.clip(x[: state.p] + scale * moved, state.low[: state.p], state.high[: state.p])
        rows = state.rows(full)
        return 1e12 if rows is None else sum_of_squares(rows) + state.prior(full)

    search: Any = minimize
    found = search(
        objective,
        np.zeros(state.p),
        method="Nelder-Mead",
        options={"maxfev": evaluations},
    )
    full = x.copy()
    full[: state.p] = np.clip(x[: state.p] + scale * found.x, state.low[: state.p], state.high[: state.p])
    return fit(problem, effects, state.point(full))
