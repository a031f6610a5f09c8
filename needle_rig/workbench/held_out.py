"""How well a fit foretells commands that it has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from needle_rig.errors import BadInput, SolverError
from needle_rig.workbench.fit import Fit
from needle_rig.workbench.friction_of_trial import FrictionOfTrial
from needle_rig.workbench.problem import Point, Problem

Array = npt.NDArray[np.float64]

UNSEEN = 1e-3
"""Directions of less curvature than this, of parameters scaled alike, are not followed."""


@dataclass(frozen=True)
class HeldOut:
    """Prediction of every trial by a fit to the trials of other commands."""

    error: float
    """Root mean square over all bins, in units of the noise (trial scatter included): 1 is the floor."""
    loss: Array
    """−2 log predictive density of each trial (T,), up to a constant."""
    residuals: tuple[Array, ...]
    """Data minus prediction in bin means (C, K), with the friction that the other trials share."""


def held_out(problem: Problem, fit: Fit) -> HeldOut:
    """Leave every command out in turn; parameters move to where the rest puts them, to first order.

    A held-out trial is then simulated afresh; its own friction is unknown and integrated out.
    """
    trials = len(problem.trials)
    p = 2 + len(fit.axes)
    groups = problem.groups
    blocks, pushes = [], []
    for jacobian, rows in zip(fit.jacobians, fit.residuals, strict=True):
        shared, own = jacobian[:, :p], jacobian[:, p]
        tight = fit.scatter**-2
        # the trial's own friction profiled out
        weight = 1.0 / (own @ own + tight)
        cross = shared.T @ own
        blocks.append(shared.T @ shared - weight * np.outer(cross, cross))
        pushes.append(shared.T @ rows - weight * cross * (own @ rows))
    prior = np.r_[0.0, problem.rigidity_prior**-2, [a.width**-2 for a in fit.axes]]
    whole = sum(blocks) + np.diag(prior)
    low = np.r_[-np.inf, -np.inf, [a.bounds[0] for a in fit.axes]]
    high = np.r_[np.inf, np.inf, [a.bounds[1] for a in fit.axes]]
    at = np.r_[fit.point.log_friction, fit.point.log_rigidity, fit.point.positions]
    models, order = [], []
    for group in groups if len(groups) > 1 else []:
        left = whole - sum(blocks[t] for t in group)
        # what the rest does not see (friction against a factor on it) stays where the fit put it
        scale = np.sqrt(np.diag(left))
        seen = np.linalg.pinv(left / np.outer(scale, scale), rcond=UNSEEN, hermitian=True)
        move = -seen @ (sum(pushes[t] for t in group) / scale) / scale
        move[0] = np.clip(move[0], -1.0, 1.0)
        move[1] = np.clip(move[1], -0.3, 0.3)
        x = np.clip(at + move, low, high)
        point = Point(float(x[0]), float(x[1]), x[2:], np.zeros(trials))
        for t in group:
            models.append(problem.model(fit.axes, point))
            order.append(t)
    nothing = HeldOut(float("inf"), np.full(trials, np.inf), (np.zeros((0, 0)),) * trials)
    if not models:
        return nothing
    try:
        readings = problem.readings(models, order)
        common = _rows(problem, fit, readings, order)
        # the model is not linear in a trial's own friction: simulated again at its first estimate
        nearest = [_own(fit, t, r, 0.0)[0] for t, r in zip(order, common, strict=True)]
        factors = [FrictionOfTrial(float(np.exp(o))) for o in nearest]
        again = [m.with_effects(f) for m, f in zip(models, factors, strict=True)]
        nearer = _rows(problem, fit, problem.readings(again, order), order)
    except (SolverError, BadInput):
        return nothing
    chi2, loss, residuals = np.zeros(trials), np.zeros(trials), list(nothing.residuals)
    for k, t in enumerate(order):
        chi2[t] = min(_own(fit, t, common[k], 0.0)[1:], _own(fit, t, nearer[k], nearest[k])[1:])[1]
        seen = fit.jacobians[t][:, p]
        loss[t] = chi2[t] + float(np.log1p((seen @ seen) * fit.scatter**2))
        residuals[t] = problem.trials[t].mean - readings[k]
    return HeldOut(float(np.sqrt(chi2.sum() / problem.size)), loss, tuple(residuals))


def _rows(problem: Problem, fit: Fit, readings: list[Array], order: list[int]) -> list[Array]:
    """Whitened data minus prediction (n,) of each trial, the fit's nuisances taken out."""
    rows = problem.residuals(readings, order)
    return [r - problem.nuisance[t] @ fit.nuisance for t, r in zip(order, rows, strict=True)]


def _own(fit: Fit, trial: int, rows: Array, at: float) -> tuple[float, float, float]:
    """Of a trial whose residuals are `rows` (n,) at its own friction `at`: (best own friction, χ² with its
    prior here, χ² at the best)."""
    seen, tight = fit.jacobians[trial][:, -1], fit.scatter**-2
    curvature = float(seen @ seen) + tight
    step = (float(seen @ rows) - tight * at) / curvature
    here = float(rows @ rows) + tight * at**2
    return float(np.clip(at + step, -1.2, 1.2)), here, here - curvature * step**2
