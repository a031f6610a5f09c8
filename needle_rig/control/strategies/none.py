"""No compensation: one turn to the target."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.control.strategy import History, Strategy, Task, Waypoint


@dataclass(frozen=True)
class NoCompensation(Strategy):
    """Base to the target; the tip stays behind by the lag. What every other strategy is compared with."""

    def next(self, task: Task, history: History) -> Waypoint | None:
        """One motion; None after it."""
        return Waypoint(task.target_rad, "rotate") if len(history) == 1 else None

    def expected_motions(self) -> int:
        """One."""
        return 1
