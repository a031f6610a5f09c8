"""The paper's sequence: turn, correct by the lag, and unwind with two reversals."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.control.strategy import History, Strategy, Task, Waypoint

SEQUENCE = (("rotate", 0.0), ("overshoot", 1.0), ("back", -0.75), ("forward", 0.25), ("final", 0.0))
"""Names of the motions, and how far beyond the target each goes, in lags."""


@dataclass(frozen=True)
class Reed2008(Strategy):
    """Base to θ_d, θ_d + θ_lag, θ_d − 0.75 θ_lag, θ_d + 0.25 θ_lag, θ_d (Reed 2008).

    θ_lag comes from the torque after the first motion by (7) or (9).
    """

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The next of the five motions; None after the last."""
        done = len(history) - 1
        return reed_motion(task, done, history[1].predicted_lag_rad if done else 0.0)

    def expected_motions(self) -> int:
        """Five."""
        return len(SEQUENCE)


def reed_motion(task: Task, done: int, lag_rad: float) -> Waypoint | None:
    """The motion after `done` of the sequence, where the lag is `lag_rad`; None after the last."""
    if done >= len(SEQUENCE):
        return None
    name, share = SEQUENCE[done]
    return Waypoint(task.target_rad + share * lag_rad, name)
