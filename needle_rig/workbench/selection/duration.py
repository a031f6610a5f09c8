"""How long a diagnosis will take, in words."""

from __future__ import annotations

import dataclasses
import math
import time

from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.estimation.simulator import Simulator

SEARCH_TIMES = (8.0, 50.0)
"""Processor time of a search over that of the first fit: 9 to 46 on the practice sets, on nothing hidden and
on 20 minutes of recording."""
QUICK_TIMES = (5.0, 20.0)
"""The same of a quick one: 9 and 12 on a camera at 10 Hz beside torque at 2 kHz."""
START_TIMES = (3.0, 60.0)
"""The same of finding unknown starts: 3 with nothing hidden, 38 where an effect holds the shaft."""
MORE_TIMES = (0.3, 1.5)
"""What follows the first step of a search, over that step times the ratio of solutions' times: 0.7 where
`stribeck` is found, whose solution takes twenty times as long as that of the model without."""
TIMINGS = 3
"""Of which the shortest counts: others hold what else the machine did."""
SLOWER = 2.0
"""Ratio of solutions' times from which it is told: below it the first telling stands."""
SHORT_S = 120.0
"""Up to which a time is told in seconds."""
LONG_S = 60.0
"""From which a quick diagnosis is offered."""


def expected(fit_s: float, processes: int, quick: bool = False) -> str:
    """How long a diagnosis will take, by how long the first fit took, and what would take less."""
    told = spell(fit_s / processes, QUICK_TIMES if quick else SEARCH_TIMES)
    if quick or SEARCH_TIMES[1] * fit_s / processes < LONG_S:
        return told
    return f"{told} (--quick: {spell(fit_s / processes, QUICK_TIMES)}, for one effect alone)"


def slower(problem: Problem, found: Fit, root: Fit, step_s: float) -> str:
    """What a search that has found more says after its first step of `step_s`; "" where it goes on as
    fast."""
    times = _solution_s(problem, found) / max(_solution_s(problem, root), 1e-9)
    if times < SLOWER:
        return ""
    names = [e for e in found.effects if e not in root.effects]
    return (
        f"a model with {' and '.join(names)} takes {times:.0f} times as long to solve:"
        f" {spell(times * step_s, MORE_TIMES)} more"
    )


def spell(unit_s: float, times: tuple[float, float]) -> str:
    """From the lower to the higher multiple of a time."""
    low_s, high_s = (each * unit_s for each in times)
    if high_s < SHORT_S:
        return f"some {max(low_s, 1.0):.0f} to {max(high_s, 2.0):.0f} s"
    return f"some {low_s / 60:.1f} to {high_s / 60:.0f} min"


def _solution_s(problem: Problem, found: Fit) -> float:
    shortest_s = math.inf
    for _ in range(TIMINGS):
        unsolved = dataclasses.replace(
            problem, simulator=Simulator()
        )  # the search's own keeps what it solved
        begun_s = time.monotonic()
        unsolved.predict(found.parameters, found.vector)
        shortest_s = min(shortest_s, time.monotonic() - begun_s)
    return shortest_s
