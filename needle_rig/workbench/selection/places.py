"""Looking for a place: an instant, or an order, that no slope of the objective leads to.

Every place is tried by what the model would answer there, to first order in the strengths, which are fitted
together; the parameters of the current fit are projected out. A fit then starts from the best and holds it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.parameters import FreeParameter
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.evidence import log_places
from needle_rig.workbench.selection.screening import (
    JOINT_SHARE,
    Screening,
    Start,
    beside,
    together,
)

STARTS = 2
"""Best places from which a fit starts, each of a row of its own."""
SURE = 0.95
"""Share of the places at which a strength is known as well as is said: nobody sees a slip in the last
instant."""


@dataclass(frozen=True)
class Place:
    """What one place promises."""

    start: Start
    error: float
    """Standard deviation of the strength that is known least, scaled."""


def look_through(problem: Problem, parent: Fit, effect: str) -> Screening:
    """Score test of an effect with a place to look for, added to `parent`.

    A gain counts beyond 2 ln m, which the best of m places has by chance. Starts, best first, are places that
    promise more.
    """
    added = problem.parameters([effect])
    strengths = [i for i, a in enumerate(added) if not a.info.shapes]
    project = LinearisedFit.of(problem, parent).projection

    def seen_at(forms: Sequence[Array]) -> list[Place | None]:
        responses = _responses(problem, parent, added, strengths, forms)
        if responses is None:
            return [None] * len(forms)
        columns = project(responses)
        each = np.split(columns, len(forms), axis=1)
        return [
            _place(added, strengths, form, e, project.missed) for form, e in zip(forms, each, strict=True)
        ]

    looked = looked_through(added, seen_at)
    if not looked:
        return Screening(effect, 0.0, (), float("inf"), 0.0)
    chances = 2.0 * log_places(added)
    best = {row: place.start for (row, _), place in reversed(looked.items())}
    starts = [Start(s.scaled_values, s.gain - chances) for s in best.values()]
    starts = sorted(starts, key=lambda s: -s.gain)[:STARTS]
    promising = tuple(start for start in starts if start.gain > 0.0)
    return Screening(
        effect,
        max(0.0, starts[0].gain),
        promising,
        float(np.quantile([place.error for place in looked.values()], SURE, method="higher")),
        float(np.abs(starts[0].scaled_values[strengths]).max()),
    )


def looked_through(
    added: Sequence[FreeParameter], seen_at: Callable[[Sequence[Array]], Sequence[Place | None]]
) -> dict[tuple[int, int], Place]:
    """The places of what a fit holds by (row, place in it), best first.

    `seen_at` is asked with forms, scaled values (k,). Of more than `screening.places` an even choice of each
    row is looked at, then those between the neighbours of the best.
    """
    held = next((i for i, a in enumerate(added) if a.places), None)
    if held is None:
        return {}
    rows = added[held].places
    seen: dict[tuple[int, int], Place] = {}
    step = math.ceil(added[held].chances / POLICY.screening.places)
    near = [(r, k) for r, row in enumerate(rows) for k in range(min(step, len(row)) // 2, len(row), step)]
    while True:
        new = [key for key in near if key not in seen]
        forms = np.zeros((len(new), len(added)))
        forms[:, held] = [added[held].scaled_value(rows[r][k]) for r, k in new]
        found = seen_at(list(forms)) if new else []
        seen |= {key: place for key, place in zip(new, found, strict=True) if place is not None}
        ranked = sorted(seen, key=lambda key: (-seen[key].start.gain, key))
        if step == 1 or not ranked:
            return {key: seen[key] for key in ranked}
        row, best = ranked[0]
        first, end = max(0, best - step + 1), min(len(rows[row]), best + step)
        step = math.ceil((end - first) / POLICY.screening.places)
        near = [(row, k) for k in range(first, end, step)]


def _responses(
    problem: Problem,
    parent: Fit,
    added: Sequence[FreeParameter],
    strengths: Sequence[int],
    forms: Sequence[Array],
) -> Array | None:
    """Whitened responses (n, forms · strengths) to each strength at a unit, form after form; None where no
    model can be made."""
    size = POLICY.screening.strengths[1]
    parameters = (*parent.parameters, *added)
    vectors, units = [], []
    for form in forms:
        for i in strengths:
            scaled_values = form.copy()
            low, high = added[i].bounds
            scaled_values[i] = np.clip(size if high > 0 else -size, low, high)
            units.append(scaled_values[i])
            vectors.append(beside(problem, parent, parameters, scaled_values))
    try:
        before = problem.predict(parent.parameters, parent.vector)
        after = problem.sketched(parent.parameters, parent.vector, parameters, vectors)
    except BadInput:
        return None
    pairs = zip(problem.whiteners, after, before, strict=True)
    whitened = np.concatenate([whiten(a - b[:, :, None]) for whiten, a, b in pairs])
    return np.asarray(whitened / np.array(units))


def _place(
    added: Sequence[FreeParameter], strengths: Sequence[int], form: Array, columns: Array, missed: Array
) -> Place | None:
    """The strengths at a place fitted together; None where the model cannot be solved there."""
    if not np.all(np.isfinite(columns)):
        return None
    best, gain = together(columns, missed)
    scaled_values = form.copy()
    for i, amount in zip(strengths, best, strict=True):
        scaled_values[i] = np.clip(amount, *added[i].bounds)
    size = float(np.sqrt((columns**2).sum(axis=0)).min())
    return Place(Start(scaled_values, JOINT_SHARE * gain), 1.0 / size if size > 0 else np.inf)
