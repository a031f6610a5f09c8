"""Effects where no initial twist is known: each is compared with initial twists of its own.

Twists that are found beside a model stand for a part of what it lacks. Under them the missing effect gains
nothing. So each effect is simulated at some sizes, initial twists are found beside it, and −2 log densities
are compared.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.workbench.estimation.baseline import (
    Baseline,
    Starts,
    starts_beside,
    under_starts,
)
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.parameters import at_strength
from needle_rig.workbench.estimation.problem import Fit
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.screening import beside


@dataclass(frozen=True)
class _Shared:
    """What every task needs; `given` are the trials as recorded."""

    baseline: Baseline
    given: Dataset


def with_own_starts(
    baseline: Baseline, given: Dataset, names: Sequence[str], lowest: float, work: Work
) -> tuple[Baseline, Fit] | None:
    """The baseline from the twists of the likeliest effect, with its fit; None where none is likelier.

    `given` are the trials as recorded, `lowest` the −2 log density that it must be below.
    """
    tasks = []
    for name in names:
        added = baseline.problem.parameters([name])
        every: Iterator[tuple[float, float]] = itertools.product(POLICY.screening.strengths, (1.0, -1.0))
        if set(baseline.problem.library[name].hooks()) <= {"observe"}:
            every = itertools.islice(every, 1)  # what changes readings alone has one minimum, from anywhere
        tasks += [(name, way) for way in dict.fromkeys(tuple(at_strength(added, *each)) for each in every)]
    work.share(_Shared(baseline, given))
    found: list[Starts] = [each for each in work.run(_own_starts, tasks) if each is not None]
    best = min(found, key=lambda starts: starts.deviance, default=None)
    if best is None or best.deviance >= lowest:
        return None
    further = starts_beside(under_starts(baseline, best), given, best.fit) or best
    other = under_starts(baseline, further)
    begin = fit(other.problem, further.fit.effects, further.fit.vector)
    return None if other is baseline or begin is None else (other, begin)


def _own_starts(shared: _Shared, name: str, scaled_values: Sequence[float]) -> Starts | None:
    """Initial twists beside an effect of this size, all else as it is."""
    problem, parent = shared.baseline.problem, shared.baseline.current
    effects = (*parent.effects, name)
    vector = beside(problem, parent, problem.parameters(effects), np.array(scaled_values))
    found = fit(problem, effects, vector, nuisance=parent.nuisance, iterations=0)
    return None if found is None else starts_beside(shared.baseline, shared.given, found, at_once=True)
