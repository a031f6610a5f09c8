"""How to go on when the model turned out wrong: the paper's sequence from where the base is."""

from __future__ import annotations

from dataclasses import replace

from needle_rig.control.strategies.reed2008 import reed_motion
from needle_rig.control.strategy import History, Reason, Task, Waypoint


def doubted_at(history: History) -> int | None:
    """The settled motion after which the paper's corrections took over, or None.

    A plain first turn is no correction: what follows it may be planned.
    """
    return next((m.index - 1 for m in history[2:] if m.reason is not Reason.STRATEGY), None)


def reed_remaining(
    task: Task, history: History, doubted: int, reason: Reason, note: str = ""
) -> Waypoint | None:
    """The next of Reed 2008's motions, of which those up to settled motion `doubted` count as the first.

    θ_lag is that of the largest torque. `note` is said with the first of them.
    """
    first = max(doubted, 1)
    lag = max((m.predicted_lag_rad for m in history[1 : first + 1]), key=abs, default=0.0)
    waypoint = reed_motion(task, len(history) - first, lag)
    if waypoint is None:
        return None
    return replace(waypoint, reason=reason, note=note)
