"""What a person asks of the base directly: one turn, as a strategy, so that the same machine runs it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from needle_rig.control.strategy import History, Strategy, Task, Waypoint

SETTLE_S = 0.1
"""A turn by hand is over when the base stands; the needle need not have settled."""
WINDOW_S = 0.1
SEARCH_RAD_S = 0.1745
"""10°/s: slow enough for an index mark of 0.1° at 1 kHz, and for a person to stop it."""


@dataclass(frozen=True)
class Turn(Strategy):
    """Turns the base to the task's target, once."""

    motion: str = "jog"
    name: ClassVar[str] = "turn"

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The one waypoint, then nothing."""
        if len(history) > 1:
            return None
        return Waypoint(task.target_rad, self.motion, settle_s=SETTLE_S)

    def expected_motions(self) -> int:
        """One."""
        return 1
