"""How long a diagnosis will take, in words."""

from __future__ import annotations

from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.problem import Problem

SEARCH_TIMES = (2000.0, 9000.0)
"""Processor time of a diagnosis over that of one solution of all trials: 2100 to 3400 with nothing hidden,
6200 to 8000 with an effect, in five shapes of experiment of 1.5 to 15 minutes."""
QUICK_TIMES = (400.0, 3200.0)
"""The same of a quick one: 610 to 1300 with nothing hidden, 420 to 3100 with an effect."""
START_TIMES = (3.0, 60.0)
"""Processor time of finding unknown starts over that of the first fit: 3 with nothing hidden, 38 where an
effect holds the shaft."""
MORE_TIMES = (0.3, 1.5)
"""What follows the first step of a search, over that step times the ratio of solutions' times: 0.7 where
`stribeck` is found, whose solution takes twenty times as long as that of the model without."""
SLOWER = 2.0
"""Ratio of solutions' times from which it is told: below it the first telling stands."""
SHORT_S = 120.0
"""Up to which a time is told in seconds."""
LONG_S = 60.0
"""From which a quick diagnosis is offered."""


def expected(solution_s: tuple[float, float], processes: int, quick: bool = False) -> str:
    """How long a diagnosis will take, and what would take less.

    By how long one solution of all trials takes at least and at most.
    """
    whole, fast = (
        spell((low * solution_s[0] / processes, high * solution_s[1] / processes))
        for low, high in (SEARCH_TIMES, QUICK_TIMES)
    )
    if quick or SEARCH_TIMES[1] * solution_s[1] / processes < LONG_S:
        return fast if quick else whole
    return f"{whole} (--quick: {fast}, for one effect alone)"


def slower(problem: Problem, found: Fit, root: Fit, step_s: float) -> str:
    """What a search that has found more says after its first step of `step_s`; "" where it goes on as
    fast."""
    mine, other = (problem.solution_s(fit.parameters, fit.vector) for fit in (found, root))
    times = mine / max(other, 1e-9)
    if times < SLOWER:
        return ""
    names = [e for e in found.effects if e not in root.effects]
    return (
        f"a model with {' and '.join(names)} takes {times:.0f} times as long to solve:"
        f" {spell((MORE_TIMES[0] * times * step_s, MORE_TIMES[1] * times * step_s))} more"
    )


def spell(between_s: tuple[float, float]) -> str:
    """From the shorter to the longer time."""
    low_s, high_s = between_s
    if high_s < SHORT_S:
        return f"some {max(low_s, 1.0):.0f} to {max(high_s, 2.0):.0f} s"
    low = f"{max(low_s, 1.0):.0f} s" if low_s < LONG_S else f"{low_s / 60:.1f}"
    return f"some {low} to {high_s / 60:.0f} min"
