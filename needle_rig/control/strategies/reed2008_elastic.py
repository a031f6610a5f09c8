"""The paper's sequence with a further first correction, for tissue that springs back."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from needle_rig.control.strategies.reed2008 import Reed2008
from needle_rig.control.strategy import History, Strategy, Task, Waypoint
from needle_rig.errors import BadInput
from needle_rig.units import deg, rad


@dataclass(frozen=True)
class Reed2008Elastic(Strategy):
    """As reed2008, the first correction further by an extra turn towards the target (Reed 2008: 12°).

    The extra turn is `extra_deg`. Without it, it is learned: what the run before used (reed2008: nothing) and
    the lag that it left.
    """

    extra_deg: float | None = None

    def __post_init__(self) -> None:
        if self.extra_deg is not None and not 0.0 <= self.extra_deg <= 360.0:
            raise BadInput(f"reed2008_elastic: extra_deg is {self.extra_deg}; give 0 to 360 degrees")

    def check(self, task: Task) -> None:
        """Refuse when there is nothing to take the extra turn from."""
        if self.extra_deg is None and task.lag_left_rad is None:
            raise BadInput(
                "reed2008_elastic does not know its extra turn: give it in degrees, or run reed2008 on this"
                " rig first: the lag that it leaves is the extra turn"
            )

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The next of the five motions; None after the last."""
        waypoint = Reed2008().next(task, history)
        if waypoint is None or len(history) != 2:
            return waypoint
        extra = rad(self.extra_used_deg(task)) * math.copysign(1.0, task.target_rad)
        return replace(waypoint, angle_rad=waypoint.angle_rad + extra)

    def extra_used_deg(self, task: Task) -> float:
        """The extra turn for this task in degrees: given or learned."""
        if self.extra_deg is not None:
            return self.extra_deg
        return max(0.0, task.extra_before_deg + deg(task.lag_left_rad or 0.0))

    def expected_motions(self) -> int:
        """Five."""
        return 5
