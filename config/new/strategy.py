"""One sentence that says how this strategy aligns the needle."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.control.strategy import History, Strategy, Task, Waypoint


@dataclass(frozen=True)
class MyThing(Strategy):
    """Base to the target, then further by a part of the lag that the torque stands for."""

    # an option: --option lag_part=0.5; its name ends in its unit, if it has one
    lag_part: float = 1.0

    # settled motions in, the next waypoint out; keep no memory: a run is replayed from its record
    def next(self, task: Task, history: History) -> Waypoint | None:
        """The turn, then one correction; None after both."""
        # history[0] is the rest before the first motion, history[-1] what just settled; angles in radians
        if len(history) == 1:
            return Waypoint(task.target_rad, "rotate")
        if len(history) == 2:
            return Waypoint(task.target_rad + self.lag_part * history[1].predicted_lag_rad, "overshoot")
        return None  # the sequence is over

    def expected_motions(self) -> int:
        """Two, for the progress bar."""
        return 2
