"""Effects where no initial twist is known: each is compared with initial twists of its own.

Twists that are found beside a model stand for a part of what it lacks. Under them the missing effect gains
nothing. So each effect is simulated at some sizes, initial twists are found beside it, and −2 log densities
are compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.workbench.estimation.baseline import (
    Baseline,
    Starts,
    starts_beside,
    under_starts,
)
from needle_rig.workbench.estimation.map_fit import Fit, fit
from needle_rig.workbench.estimation.parameters import at_strength
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.screening import beside


def with_own_starts(
    baseline: Baseline, given: Dataset, names: Sequence[str], lowest: float
) -> tuple[Baseline, Fit] | None:
    """The baseline from the twists of the likeliest effect, with its fit; None where none is likelier.

    `given` are the trials as recorded, `lowest` the −2 log density that it must be below.
    """
    best: Starts | None = None
    for found in _begun(baseline, names):
        taken = starts_beside(baseline, given, found, at_once=True)
        if taken is not None and taken.deviance < lowest:
            lowest, best = taken.deviance, taken
    if best is None:
        return None
    further = starts_beside(under_starts(baseline, best), given, best.fit) or best
    other = under_starts(baseline, further)
    begin = fit(other.problem, further.fit.effects, further.fit.vector)
    return None if other is baseline or begin is None else (other, begin)


def _begun(baseline: Baseline, names: Sequence[str]) -> Iterator[Fit]:
    """Each effect at the sizes of screening, either way, with all else as it is."""
    problem, parent = baseline.problem, baseline.current
    for name in names:
        effects = (*parent.effects, name)
        added = problem.parameters([name])
        for size in POLICY.screening.strengths:
            ways = {tuple(at_strength(added, size, turn)) for turn in (1.0, -1.0)}
            for scaled_values in ways:
                vector = beside(problem, parent, problem.parameters(effects), np.array(scaled_values))
                found = fit(problem, effects, vector, nuisance=parent.nuisance, iterations=0)
                if found is not None:
                    yield found
