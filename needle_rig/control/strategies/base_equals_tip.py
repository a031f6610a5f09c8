"""Turn, then bring the base to where the tip is."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.control.strategy import History, Strategy, Task, Waypoint


@dataclass(frozen=True)
class BaseEqualsTip(Strategy):
    """Base to θ_d, then back by the lag to the tip's angle: the torque changes sign (rejected by Reed 2008).

    The tip's angle is the one predicted from the torque; no sensor at the tip is needed.
    """

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The turn, then the way back; None after both."""
        if len(history) == 1:
            return Waypoint(task.target_rad, "rotate")
        if len(history) == 2:
            return Waypoint(history[1].base_angle_rad - history[1].predicted_lag_rad, "back")
        return None

    def expected_motions(self) -> int:
        """Two."""
        return 2
