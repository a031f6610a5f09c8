"""How long a diagnosis will take, in words."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.errors import BadInput, SolverError
from needle_rig.workbench.estimation.baseline import FirstFit
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.parameters import FreeParameter, at_strength
from needle_rig.workbench.estimation.problem import ParameterVector, Problem

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
"""Ratio of solutions' times from which it is reported: below it the first telling stands."""
SHORT_S = 120.0
"""Up to which a time is given in seconds."""
LONG_S = 60.0
"""From which a quick diagnosis is offered."""


@dataclass(frozen=True)
class Slowest:
    """The effect with which a solution of all trials takes longest, driven by a few points a motion."""

    effect: str
    solution_s: float


@dataclass
class Duration:
    """How long a diagnosis will take, told by how long solutions take."""

    processes: int
    quick: bool
    slow: Slowest | None = None

    def at_first(self, at: FirstFit) -> str:
        """Before anything is fitted, in words. Raises SolverError, BadInput."""
        least_s, most_s = (p.solution_s(at.parameters, at.vector) for p in (at.problem, at.driven))
        self.slow = slowest(at.problem, at.parameters, at.vector, least_s)
        return expected((least_s, most_s), self.processes, self.quick, self.slow)

    def from_fit(self, problem: Problem, found: Fit) -> str:
        """From the current model's fit on, in words. Raises SolverError, BadInput."""
        solution_s = problem.solution_s(found.parameters, found.vector)
        return expected((solution_s, solution_s), self.processes, self.quick, self.slow)


def slowest(
    problem: Problem, parameters: Sequence[FreeParameter], vector: ParameterVector, solution_s: float
) -> Slowest | None:
    """Which further effect of the library makes the model slow to solve, `SLOWER` times or more; None: none.

    Each is tried at its typical size beside the model at `vector`, whose solution of all trials takes
    `solution_s`, on the longest trial. Raises SolverError, BadInput.
    """
    longest = max(problem.trials, key=lambda b: b.trial.time_s.size)
    one = dataclasses.replace(problem, trials=(longest,))
    without_s = one.solution_s(parameters, vector)
    found, longest_s = None, SLOWER * without_s
    for name in sorted(set(problem.library) - {parameter.effect for parameter in parameters}):
        added = problem.parameters([name])
        values = np.concatenate([vector.scaled_values, at_strength(added, 1.0)])
        try:
            with_s = one.solution_s((*parameters, *added), dataclasses.replace(vector, scaled_values=values))
        except (SolverError, BadInput):
            continue
        if with_s >= longest_s:
            found, longest_s = Slowest(name, solution_s * with_s / max(without_s, 1e-9)), with_s
    return found


def expected(
    solution_s: tuple[float, float], processes: int, quick: bool = False, slow: Slowest | None = None
) -> str:
    """How long a diagnosis will take, and what would take less.

    By how long one solution of all trials takes at least and at most, and by the slowest effect.
    """
    if slow is not None and slow.solution_s < SLOWER * solution_s[1]:
        slow = None
    whole, fast = (_spelt(times, solution_s, processes, slow) for times in (SEARCH_TIMES, QUICK_TIMES))
    missing = f" if {slow.effect} is missing" if slow else ""
    longest_s = SEARCH_TIMES[1] * (slow.solution_s if slow else solution_s[1]) / processes
    if quick or longest_s < LONG_S:
        return (fast if quick else whole) + missing
    return f"{whole}{missing} (quick: {fast}, for one effect alone)"


def _spelt(
    times: tuple[float, float], solution_s: tuple[float, float], processes: int, slow: Slowest | None
) -> str:
    told = spell((times[0] * solution_s[0] / processes, times[1] * solution_s[1] / processes))
    return f"{told}, up to {_most(times[1] * slow.solution_s / processes)}" if slow else told


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
        return f"some {max(low_s, 1.0):.0f} to {_most(high_s)}"
    low = f"{max(low_s, 1.0):.0f} s" if low_s < LONG_S else f"{low_s / 60:.1f}"
    return f"some {low} to {_most(high_s)}"


def _most(time_s: float) -> str:
    return f"{max(time_s, 2.0):.0f} s" if time_s < SHORT_S else f"{time_s / 60:.0f} min"
