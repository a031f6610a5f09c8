"""Rotations about the target whose amplitude falls, as one takes the magnetism out of iron."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.control.strategy import History, Strategy, Task, Waypoint
from needle_rig.errors import BadInput


@dataclass(frozen=True)
class Decay(Strategy):
    """Base to θ_d, then to either side of it in turn, less far each time, then to θ_d.

    There are `rotations` of them: to θ_d ± θ_lag · `ratio`^i.
    """

    rotations: int = 6
    ratio: float = 0.7

    def __post_init__(self) -> None:
        whole = self.rotations % 1 == 0
        if not 1 <= self.rotations <= 100 or not whole or not 0.0 < self.ratio < 1.0:
            raise BadInput("decay: rotations must be a whole number from 1 to 100 and ratio between 0 and 1")

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The turn, the rotations, then the target; None after these."""
        done = len(history) - 1
        if done == 0:
            return Waypoint(task.target_rad, "rotate")
        if done <= self.rotations:
            amplitude = history[1].predicted_lag_rad * (-1) ** (done - 1) * self.ratio ** (done - 1)
            return Waypoint(task.target_rad + amplitude, f"step_{done + 1}")
        return Waypoint(task.target_rad, "final") if done == self.rotations + 1 else None

    def expected_motions(self) -> int:
        """The number of rotations and two: the turn, and the last."""
        return self.rotations + 2
