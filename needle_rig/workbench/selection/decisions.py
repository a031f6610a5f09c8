"""Present, negligible, absent or cannot tell: what can be said of each effect, with its limit."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.workbench.estimation.parameters import FreeParameter, make_effects
from needle_rig.workbench.estimation.posterior import STEP
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.answer import Decision
from needle_rig.workbench.selection.candidates import Candidate
from needle_rig.workbench.selection.evidence import adjusted_p, is_negligible
from needle_rig.workbench.selection.search import SearchTrace
from needle_rig.workbench.selection.verdict import above_noise


def decide(search: SearchTrace, named: list[str], held_out_error: float) -> dict[str, Decision]:
    """What the best set of a search says of every effect of the library.

    While the answer's error on commands left out is above the noise, what stands for the rest of it may hide
    any effect: none is absent or negligible then, and no limit holds. Nor does that of an effect that
    `may_snap`.
    """
    best = search.fits[search.best][0]
    by_name = {c.effect: c for c in search.children.get(search.best, ())}
    decisions = {}
    for name in search.names:
        parameters = search.problem.parameters([name])
        if name in best.effects:
            decisions[name] = _decision(name, best, "present" if name in named else None)
        elif name in search.negligible:
            decisions[name] = _decision(name, search.negligible[name], "negligible")
        else:
            decisions[name] = _undetected(search, name, parameters, best, by_name.get(name))
    stand = not above_noise(held_out_error)
    for name, decision in decisions.items():
        if decision.decision != "present" and (not stand or may_snap(search.problem, best, name)):
            decisions[name] = _left_open(decision)
    return decisions


def may_snap(problem: Problem, found: Fit, effect: str) -> bool:
    """Whether the fitted needle with an effect, at the smallest size that matters, snaps in one of its forms.

    A model without inertia gives neither the instant of a snap nor where it ends, so a fit stays with the
    forms that do not snap, and its size says nothing of the others.
    """
    bare = problem.model(found.parameters, found.vector).without(effect)
    added = problem.parameters([effect])
    extremes = [a.bounds if a.info.shapes else (float(np.clip(a.smallest, *a.bounds)),) for a in added]
    for scaled_values in itertools.product(*extremes):
        try:
            model = bare.with_effects(*make_effects(problem.library, added, np.array(scaled_values)))
            if model.rod(problem.trials[0].trial).snaps:
                return True
        except BadInput:
            continue
    return False


def _left_open(decision: Decision) -> Decision:
    """The same effect, of which nothing can be said."""
    return dataclasses.replace(decision, decision="cannot_tell", limit=None)


def _sizes(found: Fit, name: str) -> list[tuple[FreeParameter, float, float]]:
    """(parameter, scaled value, its standard deviation) of each size; at 0 nothing is known finer than the
    derivatives' step."""
    return [
        (a, float(x), max(float(e), STEP * (x == 0.0)))
        for a, x, e in zip(found.parameters, found.vector.scaled_values, found.scaled_errors, strict=True)
        if a.effect == name and not a.info.shapes
    ]


def _decision(name: str, found: Fit, fixed: str | None) -> Decision:
    sizes = _sizes(found, name)
    parameter, at, error = max(
        sizes, key=lambda s: (abs(s[1]) + POLICY.evidence.limit_sigmas * s[2]) / max(s[0].smallest, 1e-9)
    )
    limit = abs(at) + POLICY.evidence.limit_sigmas * error
    below = all(abs(x) + POLICY.evidence.limit_sigmas * e < a.smallest for a, x, e in sizes)
    return decision_at(name, parameter, limit, fixed or ("absent" if below else "cannot_tell"), at)


def decision_at(name: str, parameter: FreeParameter, limit: float, decision: str, at: float) -> Decision:
    """The decision on the effect whose size along `parameter` is `at`, `limit` at most."""
    low, high = parameter.bounds
    way = (1.0 if at > 0 else -1.0) if at else (1.0 if high > 0 else -1.0)
    value = parameter.value(float(np.clip(way * limit, low, high)))
    if parameter.info.scale == "linear":
        value = abs(value - parameter.info.off)
        return Decision(
            name, decision, value, parameter.field, parameter.info.unit, _smallest_size(parameter)
        )
    downwards = parameter.info.off > parameter.info.typical
    if not np.isfinite(value):  # less of it than its file allows
        value = parameter.info.upper
    return Decision(
        name, decision, value, parameter.field, parameter.info.unit, parameter.info.smallest, downwards
    )


def _smallest_size(parameter: FreeParameter) -> float:
    return abs(parameter.info.smallest - parameter.info.off)


def _undetected(
    search: SearchTrace,
    name: str,
    parameters: tuple[FreeParameter, ...],
    best: Fit,
    candidate: Candidate | None,
) -> Decision:
    strength = next(a for a in parameters if not a.info.shapes)
    if candidate is None:
        return decision_at(name, strength, np.inf, "cannot_tell", 0.0)
    found = candidate.fit
    seen = found is not None and adjusted_p(best, found, len(search.names)) < POLICY.evidence.significance
    if any(a.held for a in parameters) and not seen:
        found = None  # a fit knows one place; screening looked at all of them
    if found is None or not np.all(np.isfinite(found.scaled_errors)):
        limit = candidate.screening.estimate + POLICY.evidence.limit_sigmas * candidate.screening.error
        return decision_at(
            name, strength, limit, "absent" if limit < strength.smallest else "cannot_tell", 0.0
        )
    decided = _decision(name, found, None)
    if seen:
        fixed = "negligible" if is_negligible(found, name) else "cannot_tell"
        return _decision(name, found, fixed)
    return decided
