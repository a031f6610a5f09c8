"""Present, negligible, absent or cannot tell: what can be said of each effect, with its limit."""

from __future__ import annotations

import dataclasses

import numpy as np

from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.parameters import Coordinate
from needle_rig.workbench.estimation.posterior import STEP
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.answer import Decision
from needle_rig.workbench.selection.evidence import chance, is_negligible
from needle_rig.workbench.selection.search import Candidate, SearchTrace
from needle_rig.workbench.selection.verdict import above_noise


def decide(search: SearchTrace, named: list[str], held_out_error: float) -> dict[str, Decision]:
    """What the best set of a search says of every effect of the library.

    While the answer's error on commands left out is above the noise, what stands for the rest of it may hide
    any effect: none is absent or negligible then, and no limit holds.
    """
    best = search.fits[search.best][0]
    by_name = {c.effect: c for c in search.children.get(search.best, ())}
    decisions = {}
    for name in search.names:
        axes = search.problem.axes([name])
        if name in best.effects:
            decisions[name] = _decision(name, best, "present" if name in named else None)
        elif name in search.negligible:
            decisions[name] = _decision(name, search.negligible[name], "negligible")
        else:
            decisions[name] = _undetected(search, name, axes, best, by_name.get(name))
    if not above_noise(held_out_error):
        return decisions
    return {n: d if d.decision == "present" else open_decision(d) for n, d in decisions.items()}


def open_decision(decision: Decision) -> Decision:
    """The same effect, of which nothing can be said."""
    return dataclasses.replace(decision, decision="cannot_tell", limit=None)


def _sizes(found: Fit, name: str) -> list[tuple[Coordinate, float, float]]:
    """(axis, position, its error) of each size; at 0 nothing is known finer than the derivatives' step."""
    return [
        (a, float(x), max(float(e), STEP * (x == 0.0)))
        for a, x, e in zip(found.axes, found.point.positions, found.position_error, strict=True)
        if a.effect == name and not a.info.shapes
    ]


def _decision(name: str, found: Fit, fixed: str | None) -> Decision:
    sizes = _sizes(found, name)
    axis, at, error = max(
        sizes, key=lambda s: (abs(s[1]) + POLICY.evidence.limit_sigmas * s[2]) / max(s[0].smallest, 1e-9)
    )
    limit = abs(at) + POLICY.evidence.limit_sigmas * error
    below = all(abs(x) + POLICY.evidence.limit_sigmas * e < a.smallest for a, x, e in sizes)
    return decision_at(name, axis, limit, fixed or ("absent" if below else "cannot_tell"), at)


def decision_at(name: str, axis: Coordinate, limit: float, decision: str, at: float) -> Decision:
    """The decision on the effect whose size, `limit` at most, is measured along `axis`; it stands at `at`."""
    low, high = axis.bounds
    way = (1.0 if at > 0 else -1.0) if at else (1.0 if high > 0 else -1.0)
    value = axis.value(float(np.clip(way * limit, low, high)))
    if axis.info.scale == "linear":
        value = abs(value - axis.info.off)
        return Decision(name, decision, value, axis.field, axis.info.unit, _smallest_size(axis))
    downwards = axis.info.off > axis.info.typical
    return Decision(name, decision, value, axis.field, axis.info.unit, axis.info.smallest, downwards)


def _smallest_size(axis: Coordinate) -> float:
    return abs(axis.info.smallest - axis.info.off)


def _undetected(
    search: SearchTrace, name: str, axes: tuple[Coordinate, ...], best: Fit, candidate: Candidate | None
) -> Decision:
    strength = next(a for a in axes if not a.info.shapes)
    if candidate is None:
        return decision_at(name, strength, np.inf, "cannot_tell", 0.0)
    found = candidate.fit
    if found is None or not np.all(np.isfinite(found.position_error)):
        limit = candidate.preview.estimate + POLICY.evidence.limit_sigmas * candidate.preview.error
        return decision_at(
            name, strength, limit, "absent" if limit < strength.smallest else "cannot_tell", 0.0
        )
    decided = _decision(name, found, None)
    if chance(best, found, len(search.names)) < POLICY.evidence.significance:
        fixed = "negligible" if is_negligible(found, name) else "cannot_tell"
        return _decision(name, found, fixed)
    return decided
