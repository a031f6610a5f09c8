"""The paper's sequence: turn, correct by the lag, and unwind with two reversals."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.control.strategy import History, Strategy, Task, Waypoint


@dataclass(frozen=True)
class Reed2008(Strategy):
    """Base to θ_d, θ_d + θ_lag, θ_d − 0.75 θ_lag, θ_d + 0.25 θ_lag, θ_d (Reed 2008).

    θ_lag comes from the torque after the first motion by (7) or (9).
    """

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The five motions in turn."""
        if len(history) == 1:
            return Waypoint(task.target_rad, "rotate")
        if len(history) > 5:
            return None
        name, share = (("overshoot", 1.0), ("back", -0.75), ("forward", 0.25), ("final", 0.0))[
            len(history) - 2
        ]
        return Waypoint(task.target_rad + share * history[1].predicted_lag_rad, name)

    def expected_motions(self) -> int:
        """Five."""
        return 5
