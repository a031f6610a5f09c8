"""The curve from halves of the trials: shown where these have data."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.laws.law import UNIT, Law


def where_seen(
    problem: Problem, law: Law, at: Array, halves: Sequence[Array], seen: Callable[[Problem, Law], Array]
) -> tuple[Array, ...]:
    """Curves (n,) from every other trial and from the others, NaN outside what `seen` gives of those, SI.

    Where only one half could be fitted, nobody knows which: it is left as it is.
    """
    if len(halves) == 1:
        return tuple(halves)
    step, shown = at[1] - at[0], []
    for number, half in enumerate(halves):
        trials = [t for k, t in enumerate(problem.trials) if k % 2 == number]
        values = seen(problem.over(trials), law) / UNIT[law.variable_unit][2]
        there = (at >= values.min() - step) & (at <= values.max() + step)
        shown.append(np.where(there, half, np.nan))
    return tuple(shown)
