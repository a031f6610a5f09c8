"""Turn, then back until no torque is left at the base."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.control.lag import unwinding_rad
from needle_rig.control.strategy import History, Strategy, Task, Waypoint
from needle_rig.errors import BadInput
from needle_rig.units import nm


@dataclass(frozen=True)
class Relax(Strategy):
    """Base to θ_d, then to zero torque by feedback on the settled torque (rejected by Reed 2008).

    The first way back is that of rigid tissue; the others follow the torque's slope between the last two
    settled motions, until less than `torque_nmm` is left or `corrections` are used up. In the model geometry
    one ninth of the lag stays.
    """

    torque_nmm: float = 0.002
    corrections: int = 4

    def __post_init__(self) -> None:
        if not self.torque_nmm > 0 or not 1 <= self.corrections <= 20:
            raise BadInput("relax: torque_nmm must be above 0 and corrections from 1 to 20")

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The turn, then corrections; None when the sequence is over."""
        if len(history) == 1:
            return Waypoint(task.target_rad, "rotate")
        last = history[-1]
        if abs(last.torque_nm) <= nm(self.torque_nmm) or len(history) - 2 >= self.corrections:
            return None
        turn = unwinding_rad(last.torque_nm, task.layout, task.torsional_rigidity_nm2)
        if len(history) > 2:
            before = history[-2]
            moved = last.base_angle_rad - before.base_angle_rad
            eased = last.torque_nm - before.torque_nm
            if moved * eased > 0.0:
                turn = last.torque_nm * moved / eased
        return Waypoint(last.base_angle_rad - turn, f"step_{len(history)}")

    def expected_motions(self) -> int:
        """Three: the turn and usually two corrections."""
        return 3
