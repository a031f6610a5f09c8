"""One correction by the lag of a needle whose friction sits at its tip."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.control.strategy import History, Strategy, Task, Waypoint


@dataclass(frozen=True)
class TipFriction(Strategy):
    """Base to θ_d, then further by τ · l_out/JG with l_out the whole needle (Abolhassani et al.).

    In the paper's model geometry 22 % more than friction along the shaft asks for.
    """

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The turn, then one correction; None after both."""
        if len(history) == 1:
            return Waypoint(task.target_rad, "rotate")
        if len(history) == 2:
            lag = history[1].torque_nm * task.layout.needle_length_m / task.torsional_rigidity_nm2
            return Waypoint(task.target_rad + lag, "overshoot")
        return None

    def expected_motions(self) -> int:
        """Two."""
        return 2
