"""How to go on when the model turned out wrong: the paper's sequence from where the base is."""

from __future__ import annotations

from needle_rig.control.strategy import History, Task, Waypoint

SHARES = (("overshoot", 1.0), ("back", -0.75), ("forward", 0.25), ("final", 0.0))


def doubted_at(history: History) -> int | None:
    """The settled motion after which the paper's sequence took over, told by its motions' names, or None."""
    taken = next((motion.index for motion in history if motion.name == SHARES[0][0]), None)
    return None if taken is None else taken - 1


def reed_remaining(task: Task, history: History, doubted: int, why: str) -> Waypoint | None:
    """Reed 2008's motions after the first, after settled motion `doubted`; θ_lag by the largest torque."""
    done = len(history) - 1 - doubted
    if done >= len(SHARES):
        return None
    lag = max((m.predicted_lag_rad for m in history[1 : doubted + 1]), key=abs)
    name, share = SHARES[done]
    return Waypoint(task.target_rad + share * lag, name, note=why if done == 0 else "")
