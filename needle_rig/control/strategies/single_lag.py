"""One correction by the lag that the torque stands for."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.control.strategy import History, Strategy, Task, Waypoint


@dataclass(frozen=True)
class SingleLag(Strategy):
    """Base to θ_d, then further by θ_lag of (7) or (9) : the tip arrives, the shaft stays wound."""

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The turn, then one correction; None after both."""
        if len(history) == 1:
            return Waypoint(task.target_rad, "rotate")
        if len(history) == 2:
            return Waypoint(task.target_rad + history[1].predicted_lag_rad, "overshoot")
        return None

    def expected_motions(self) -> int:
        """Two."""
        return 2
