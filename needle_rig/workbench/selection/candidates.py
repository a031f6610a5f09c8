"""Fits of one more effect: a candidate on top of a parent, from the starts that screening found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needle_rig.workbench.estimation.cross_validation import CrossValidation, cross_validate
from needle_rig.workbench.estimation.map_fit import EXCESS_TOLERANCE, ROUGH, fit
from needle_rig.workbench.estimation.multistart import lowest_fit, over_forms
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.evidence import log_places
from needle_rig.workbench.selection.places import look_through
from needle_rig.workbench.selection.screening import Screening, beside, screen

REFINED = 10
"""Times `ROUGH`: a fit whose tolerance is larger than that has ended by it, not early."""


@dataclass(frozen=True)
class Candidate:
    """A parent with one more effect."""

    effect: str
    fit: Fit | None
    validation: CrossValidation | None
    screening: Screening


def penalty(problem: Problem) -> float:
    """Price of one parameter in the objective."""
    return float(np.log(POLICY.search.price_times_trials * len(problem.trials)))


def score(problem: Problem, found: Fit) -> float:
    """Objective with its price for parameters; lower is better.

    A place that was looked for costs −2 log of its prior, one in as many as there are.
    """
    return found.objective + penalty(problem) * found.rank + 2.0 * log_places(found.parameters)


def refinable(problem: Problem, found: Fit) -> bool:
    """Whether a first fit ended early: one that misses by far ends where a refined fit would."""
    return EXCESS_TOLERANCE * excess(problem, found.objective) < REFINED * ROUGH


def screened(problem: Problem, parent: Fit, effect: str) -> Candidate:
    """`effect` on top of `parent`, not fitted yet."""
    placed = problem.library[effect].is_placed()
    ahead = look_through(problem, parent, effect) if placed else screen(problem, parent, effect)
    return Candidate(effect, None, None, ahead)


def try_effect(problem: Problem, parent: Fit, effect: str) -> Candidate:
    """Screen and fit `effect` on top of `parent`."""
    return fitted(problem, parent, screened(problem, parent, effect))


def fitted(problem: Problem, parent: Fit, candidate: Candidate) -> Candidate:
    """A candidate on top of `parent`, fitted from its starts."""
    effect, ahead = candidate.effect, candidate.screening
    names = (*parent.effects, effect)
    parameters = problem.parameters(names)
    starts = [beside(problem, parent, parameters, start.scaled_values) for start in ahead.starts]
    best = lowest_fit(problem, names, starts, nuisance=parent.nuisance, tolerance=ROUGH)
    if best is not None and refinable(problem, best):
        if parent.objective - best.objective > POLICY.evidence.likely_sigmas**2:
            best = fit(problem, names, best.vector, nuisance=best.nuisance) or best
        if excess(problem, best.objective) > 0.0:
            best = over_forms(problem, best)
    return Candidate(effect, best, cross_validate(problem, best) if best is not None else None, ahead)


def refit(
    problem: Problem, names: tuple[str, ...], start: ParameterVector
) -> tuple[Fit | None, CrossValidation | None]:
    """Fit from a given parameter vector, with its cross-validation."""
    found = fit(problem, names, start)
    return found, cross_validate(problem, found) if found is not None else None


def without(found: Fit, effect: str) -> ParameterVector:
    """A fit's parameter vector with one effect taken out."""
    keep = [i for i, a in enumerate(found.parameters) if a.effect != effect]
    return ParameterVector(
        found.vector.log_friction,
        found.vector.log_rigidity,
        found.vector.scaled_values[keep],
        found.vector.trial_friction,
    )
