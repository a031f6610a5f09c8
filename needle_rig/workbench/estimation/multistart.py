"""Searches among the minima of a jagged objective: strengths, and shapes that lie close together."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.map_fit import OBJECTIVE_TOLERANCE, fit
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem

MOST_WALKS = 4
"""Restarts of a fit at most."""
FORM_STEPS = (0.3, -0.3)
"""Steps of a form parameter from which a fit is restarted, in scaled values: a factor of two where the scale
is a decade."""

FACTORS = (1.4, 0.7, 2.0, 0.5)
"""Strength of an effect, in that of a fit, from which it is restarted, by half octaves: where initial twists
are unknown, a node that friction holds, or just not, in one hold makes a valley of its own."""

WORTH_GOING_ON = 1.0
"""Fall of the objective from which a lower minimum is itself a start."""


def lowest_fit(
    problem: Problem,
    effects: Sequence[str],
    starts: Iterable[ParameterVector],
    best: Fit | None = None,
    *,
    nuisance: Array | None = None,
    tolerance: float = OBJECTIVE_TOLERANCE,
) -> Fit | None:
    """The lowest of `best` and the fits from `starts`; None where the model can be solved at none of them."""
    for start in starts:
        found = fit(problem, effects, start, nuisance=nuisance, tolerance=tolerance)
        if found is not None and (best is None or found.objective < best.objective - OBJECTIVE_TOLERANCE):
            best = found
    return best


def over_strength(problem: Problem, effects: Sequence[str], start: ParameterVector) -> Fit | None:
    """The lowest of fits from several strengths of the last effect, about that of the lowest before."""
    strengths = [a.effect == effects[-1] and not a.info.shapes for a in problem.parameters(effects)]
    best = fit(problem, effects, start)
    if best is None:
        return None
    for factor in FACTORS:
        values = np.where(strengths, factor, 1.0) * best.vector.scaled_values
        other = dataclasses.replace(best.vector, scaled_values=values)
        best = lowest_fit(problem, effects, [other], best) or best
    return best


def over_forms(problem: Problem, found: Fit) -> Fit:
    """The lowest of fits from several form parameters of the last effect (multistart).

    Its covariance is that of the mixture of all minima, weighted by their posterior probabilities.
    """
    met = [found]
    for _ in range(MOST_WALKS):
        further = _from_other_forms(problem, found)
        met += further
        again = min(further, key=lambda f: f.objective, default=found)
        if again.objective > found.objective - WORTH_GOING_ON:
            break
        found = again
    found = min(met, key=lambda f: f.objective)
    return dataclasses.replace(found, covariance=_mixture_covariance(found, met))


def _mixture_covariance(lowest: Fit, met: Sequence[Fit]) -> Array:
    """Second moment (p, p) about the lowest of several minima, as a mixture; a minimum met twice counts
    once."""
    at = [f.vector.shared for f in met]
    centre = lowest.vector.shared
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


def _from_other_forms(problem: Problem, found: Fit) -> list[Fit]:
    fits = []
    for i, parameter in enumerate(found.parameters):
        if parameter.info.shapes and not parameter.held and parameter.effect == found.effects[-1]:
            for step in FORM_STEPS:
                scaled_values = found.vector.scaled_values.copy()
                scaled_values[i] += step
                start = dataclasses.replace(found.vector, scaled_values=scaled_values)
                fits.append(fit(problem, found.effects, start, nuisance=found.nuisance))
    return [f for f in fits if f is not None]
