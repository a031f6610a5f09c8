"""Screening: a score test at finite strength of each effect, from a few simulations, and starts for its fit.

A signature is the whitened response of the model to an effect at 0.1, 0.5 and 1.5 of its typical size,
because derivatives at zero strength miss most of what dry friction does. All parameters of the current fit
are projected out of it.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.parameters import FreeParameter, against_mean
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem
from needle_rig.workbench.estimation.slip_limits import log_slip_limits
from needle_rig.workbench.policy import POLICY

LEAST_SCALE, MOST_SCALE = 0.02, 4.0
"""A signature is scaled to the best size within these: dry friction is far from linear."""
SCALED_SHARE = 0.9
"""Share of the gain of a scaled signature that is expected, beside that of one as simulated."""
JOINT_SHARE = 0.8
"""Share of the gain of several signatures together that is expected."""
RIDGE = 0.01
"""Ridge of the fit of several signatures together, against collinear ones."""


@dataclass(frozen=True)
class Start:
    """Where to start a fit: scaled values (k,) of the effect, and the expected fall of the objective."""

    scaled_values: Array
    gain: float


@dataclass(frozen=True)
class Screening:
    """Score test of one effect added to a fit."""

    effect: str
    gain: float
    """Expected fall of the objective."""
    starts: tuple[Start, ...]
    """Best first."""
    error: float
    """Standard deviation of the strength, scaled, from the signature at the smallest strength."""
    estimate: float
    """The strength itself, scaled, from the same signature."""


def _tried_together(parameters: Sequence[FreeParameter]) -> list[list[int]]:
    """Groups of parameters that are tried together: items of a field one by one, single fields at once."""
    single = [i for i, a in enumerate(parameters) if not a.info.shapes and a.item is None]
    each = [[i] for i, a in enumerate(parameters) if not a.info.shapes and a.item is not None]
    return ([single] if single else []) + each


def screen(problem: Problem, parent: Fit, effect: str) -> Screening:
    """Score test of `effect` added to `parent` with its typical form; its gain is 0 where the model cannot be
    solved."""
    project = LinearisedFit.of(problem, parent).projection
    added = problem.parameters([effect])
    parameters = (*parent.parameters, *added)
    residual = project.missed
    groups = _tried_together(added)
    starts: list[Start] = []
    error, estimate = float("inf"), 0.0
    for group, strength in itertools.product(groups, POLICY.screening.strengths):
        for sign in _signs([added[i] for i in group]):
            scaled_values = np.zeros(len(added))
            for i in group:
                scaled_values[i] = np.clip(sign * strength, *added[i].bounds)
            change = signature(problem, parent, parameters, scaled_values) if scaled_values.any() else None
            if change is None:
                continue
            projected = project(*change)
            size, along = float(projected @ projected), float(residual @ projected)
            scale = float(np.clip(along / size, -MOST_SCALE, MOST_SCALE)) if size > 0 else 0.0
            starts.append(Start(scaled_values, 2 * along - size))
            if abs(scale) > LEAST_SCALE and (scale > 0 or not all(added[i].one_sided for i in group)):
                at_best = scaled_values.copy()
                for i in group:
                    at_best[i] = np.clip(scale * scaled_values[i], *added[i].bounds)
                starts.append(Start(at_best, SCALED_SHARE * along**2 / size))
            if strength == POLICY.screening.strengths[0] and size > 0 and strength / np.sqrt(size) < error:
                error = strength / np.sqrt(size)
                estimate = abs(along / size * strength) if along > 0 or len(groups) > 1 else 0.0
    best = sorted(starts, key=lambda start: -start.gain)[:1]
    return Screening(effect, max([0.0, *(s.gain for s in best)]), tuple(best), error, estimate)


def _signs(group: Sequence[FreeParameter]) -> tuple[float, ...]:
    """Ways in which parameters that are tried together can go."""
    if not all(a.one_sided for a in group):
        return 1.0, -1.0
    return (1.0,) if all(a.bounds[1] > 0 for a in group) else (-1.0,)


def together(matrix: Array, residual: Array) -> tuple[Array, float]:
    """(amounts (m,), gain) of signatures (n, m) fitted together to what is missed (n,)."""
    ridge = np.sqrt(RIDGE) * np.eye(matrix.shape[1])
    padded = np.r_[residual, np.zeros(matrix.shape[1])]
    best = np.linalg.lstsq(np.vstack([matrix, ridge]), padded, rcond=None)[0]
    return best, float(best @ (matrix.T @ residual))


def beside(
    problem: Problem, parent: Fit, parameters: Sequence[FreeParameter], scaled_values: Array
) -> ParameterVector:
    """The parent's optimum with an effect at `scaled_values`, each trial's slip limits as large as before.

    Otherwise friction that the random effects stand for in the parent would be there twice.
    """
    every = against_mean(parameters, np.r_[parent.vector.scaled_values, scaled_values])
    vector = dataclasses.replace(parent.vector, scaled_values=every)
    added = {p.effect for p in parameters[len(parent.parameters) :]}
    if not any(problem.library[effect].has("shape") for effect in added):
        return vector
    before = log_slip_limits(problem, parent.parameters, parent.vector)
    change = np.nan_to_num(log_slip_limits(problem, parameters, vector) - before)
    return dataclasses.replace(vector, trial_friction=vector.trial_friction - change)


def signature(
    problem: Problem, parent: Fit, parameters: Sequence[FreeParameter], scaled_values: Array
) -> tuple[Array, Array] | None:
    """Whitened response of the model (n,) over all trials to an effect at `scaled_values`, and the change of
    the trials' friction (T,) that goes with it. None where the model cannot be solved."""
    vector = beside(problem, parent, parameters, scaled_values)
    trials = range(len(problem.trials))
    try:
        readings = problem.predict(parameters, vector)
    except (SolverError, BadInput):
        return None
    after = problem.residuals(readings, trials)
    change = []
    for t in trials:
        change.append(parent.residuals[t] + problem.nuisance[t] @ parent.nuisance - after[t])
    found, moved = np.concatenate(change), vector.trial_friction - parent.vector.trial_friction
    return (found, moved - moved.mean()) if np.all(np.isfinite(found)) else None
