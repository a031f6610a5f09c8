"""Fits of one more effect: a candidate on top of a parent, from the starts that screening found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.workbench.estimation.cross_validation import CrossValidation, cross_validate
from needle_rig.workbench.estimation.map_fit import EXCESS_TOLERANCE, Fit, fit
from needle_rig.workbench.estimation.multistart import (
    fit_without_derivatives,
    lowest_fit,
    over_friction,
    through_valleys,
)
from needle_rig.workbench.estimation.parameters import either_way
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import ParameterVector, Problem
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.evidence import log_places
from needle_rig.workbench.selection.places import look_through
from needle_rig.workbench.selection.screening import Screening, Start, beside, screen

HALF_AS_GOOD = 0.5
"""Share of the best start's gain from which another start is fitted, and of the promise that a fit should
keep."""
MOST_FITS = 3
"""Starts of an effect that are fitted."""
REFINED = 10
"""Times `search.rough`: a fit whose tolerance is larger than that has ended by it, not early."""
WORSE_FITS = 3.0
"""Tolerances of a fit by which a child may be worse than its parent before it is fitted again."""
NEARLY_OFF = 1e-3
"""Scaled value of an effect that is off but for the tolerance of a fit."""


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
    return EXCESS_TOLERANCE * excess(problem, found.objective) < REFINED * POLICY.search.rough


def _worth_fitting(ahead: Screening) -> list[Start]:
    """The best start, and those of the next two that promise half as much and more than chance."""
    least = max(HALF_AS_GOOD * ahead.gain, POLICY.search.promising)
    return [*ahead.starts[:1], *(s for s in ahead.starts[1:MOST_FITS] if s.gain > least)]


def try_effect(
    problem: Problem, parent: Fit, effect: str, more: tuple[Start, ...] = (), worth: float = -1.0
) -> Candidate:
    """Fit `effect` on top of `parent` from its best starts, unless screening promises less than `worth`."""
    placed = problem.library[effect].is_placed()
    ahead = look_through(problem, parent, effect) if placed else screen(problem, parent, effect, worth)
    if ahead.gain < worth and not more:
        return Candidate(effect, None, None, ahead)
    return _fitted(problem, parent, ahead, [*more, *_worth_fitting(ahead)])


def from_finite_strengths(problem: Problem, parent: Fit, known: Candidate) -> Candidate:
    """A candidate, or what it is when fitted from finite strengths where that is lower (multistart)."""
    return lower(known, _fitted(problem, parent, known.screening, finite_starts(problem, known)))


def finite_starts(problem: Problem, known: Candidate) -> list[Start]:
    """An effect at each size but the smallest at which it is simulated, either way where it has two.

    Screening, which follows each response along a straight line, may promise nothing of what they lead to.
    What a fit holds has been looked through: it has no other starts.
    """
    added = problem.parameters([known.effect])
    if any(a.held for a in added):
        return list(known.screening.starts)
    sizes = POLICY.screening.strengths[1:]
    return [Start(way, np.inf) for size in sizes for way in either_way(added, size)]


def _fitted(problem: Problem, parent: Fit, ahead: Screening, starts: Sequence[Start]) -> Candidate:
    """The lowest fit from `starts` of the effect that was screened, refined where it is worth it."""
    names = (*parent.effects, ahead.effect)
    parameters = problem.parameters(names)
    vectors = [beside(problem, parent, parameters, start.scaled_values) for start in starts]
    best = lowest_fit(problem, names, vectors, nuisance=parent.nuisance, tolerance=POLICY.search.rough)
    if best is not None and refinable(problem, best):
        if parent.objective - best.objective > POLICY.search.promising:
            best = fit(problem, names, best.vector, nuisance=best.nuisance) or best
        best = through_valleys(problem, best)
    room = 1.0 + WORSE_FITS * EXCESS_TOLERANCE * excess(problem, parent.objective)
    off = best is not None and bool(
        np.all(np.abs(best.vector.scaled_values[len(parent.parameters) :]) < NEARLY_OFF)
    )
    if starts and not off and (best is None or best.objective > parent.objective + room):
        # from the parent's optimum with the effect off nothing can become worse
        idle = np.zeros(len(starts[0].scaled_values))
        retry = fit(problem, names, beside(problem, parent, parameters, idle), nuisance=parent.nuisance)
        hoped = parent.objective - HALF_AS_GOOD * ahead.gain
        if ahead.gain > POLICY.search.promising and (retry is None or retry.objective > hoped):
            retry = fit_without_derivatives(problem, names, vectors[0]) or retry
        if retry is not None and (best is None or retry.objective < best.objective):
            best = retry
    return Candidate(ahead.effect, best, cross_validate(problem, best) if best is not None else None, ahead)


def refit(
    problem: Problem, names: tuple[str, ...], start: ParameterVector
) -> tuple[Fit | None, CrossValidation | None]:
    """Fit from a given parameter vector, with its cross-validation."""
    found = fit(problem, names, start)
    return found, cross_validate(problem, found) if found is not None else None


def from_other_friction(problem: Problem, found: Fit) -> tuple[Fit, CrossValidation | None]:
    """The lowest of a fit and those from other friction, with its cross-validation; None where it stays."""
    best = over_friction(problem, found)
    return best, cross_validate(problem, best) if best is not found else None


def without(found: Fit, effect: str) -> ParameterVector:
    """A fit's parameter vector with one effect taken out."""
    keep = [i for i, a in enumerate(found.parameters) if a.effect != effect]
    return ParameterVector(
        found.vector.log_friction,
        found.vector.log_rigidity,
        found.vector.scaled_values[keep],
        found.vector.trial_friction,
    )


def from_limits(problem: Problem, work: Work, parent: Fit, found: Sequence[Candidate]) -> list[Candidate]:
    """Candidates refitted from their special cases where they fit worse than these.

    A special case is an effect that a candidate becomes at an extreme of its parameters.
    """
    fitted = {c.effect: c.fit for c in found if c.fit is not None}
    tasks, places = [], []
    for place, candidate in enumerate(found):
        limits = problem.library[candidate.effect].limits
        known = [(fitted[limit], limit, extremes) for limit, extremes in limits.items() if limit in fitted]
        lowest = min((fit.objective for fit, _, _ in known), default=np.inf)
        if known and (candidate.fit is None or candidate.fit.objective > lowest + POLICY.search.rough):
            starts = tuple(_limit_start(problem, candidate.effect, *k) for k in known)
            tasks.append((parent, candidate.effect, starts))
            places.append(place)
    result = list(found)
    for place, again in zip(places, work.run(try_effect, tasks), strict=True):
        result[place] = lower(found[place], again)
    return result


def lower(one: Candidate, other: Candidate) -> Candidate:
    """The candidate that fits better, the first where neither does."""
    if other.fit is None or (one.fit is not None and one.fit.objective <= other.fit.objective):
        return one
    return other


def _limit_start(
    problem: Problem, effect: str, known: Fit, limit: str, extremes: Mapping[str, float]
) -> Start:
    """A start at which `effect` equals its fitted special case `limit`.

    Fields of the same name are taken over; the others stand at their `extremes`.
    """
    added = problem.parameters([effect])
    values = {
        (a.field, a.item): a.value(float(x))
        for a, x in zip(known.parameters, known.vector.scaled_values, strict=True)
        if a.effect == limit
    }
    scaled_values = np.zeros(len(added))
    for i, parameter in enumerate(added):
        value = extremes.get(parameter.field, values.get((parameter.field, parameter.item)))
        if value is not None and (value != parameter.info.off or parameter.info.shapes):
            inside = min(max(value, parameter.info.lower), parameter.info.upper)
            scaled_values[i] = np.clip(parameter.scaled_value(inside), *parameter.bounds)
    return Start(scaled_values, np.inf)
