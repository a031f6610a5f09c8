"""A list of base angles, for experiments that are no alignment."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needle_rig.control.ranges import settle_fault, speed_fault
from needle_rig.control.strategy import History, Strategy, Task, Waypoint
from needle_rig.errors import BadInput
from needle_rig.units import deg, rad

Each = float | tuple[float, ...] | list[float] | None


@dataclass(frozen=True)
class Protocol(Strategy):
    """Base to each angle of a list in turn, with a rest after each.

    The list is `steps_deg`, the speed `speed_deg_s`, the rest `dwell_s`. Speed and rest are one number for
    all steps, a list with one for each, or None for the rig's own.
    """

    steps_deg: tuple[float, ...] | list[float] = ()
    speed_deg_s: Each = None
    dwell_s: Each = None

    def __post_init__(self) -> None:
        if not self.steps_deg:
            raise BadInput("protocol: steps_deg is empty; give the base angles in turn, in degrees")
        for field in ("speed_deg_s", "dwell_s"):
            value = getattr(self, field)
            if isinstance(value, list | tuple) and len(value) != len(self.steps_deg):
                raise BadInput(f"protocol: {field} has {len(value)} values for {len(self.steps_deg)} steps")
        for field in ("steps_deg", "speed_deg_s", "dwell_s"):
            value = getattr(self, field)
            for number, one in enumerate(value if isinstance(value, list | tuple) else (value,), 1):
                if one is not None and not (math.isfinite(one) and (field == "steps_deg" or one > 0.0)):
                    raise BadInput(f"protocol: {field} of step {number} is {one}; give a number above 0")

    def check(self, task: Task) -> None:
        """Refuse steps beyond the drive's limits, before the first."""
        limit = task.angle_limit_rad
        for number, angle in enumerate(self.steps_deg, 1):
            if abs(rad(angle)) > limit:
                raise BadInput(f"protocol: step {number} is {angle:g}°, outside ±{deg(limit):g}°")
            speed, dwell_s = _each(self.speed_deg_s, number - 1), _each(self.dwell_s, number - 1)
            fault = None if speed is None else speed_fault(rad(speed), task.velocity_limit_rad_s)
            fault = fault or (None if dwell_s is None else settle_fault(dwell_s))
            if fault is not None:
                raise BadInput(f"protocol: in step {number} {fault}")

    def next(self, task: Task, history: History) -> Waypoint | None:  # noqa: ARG002 see Strategy
        """The next step of the list; None after the last."""
        done = len(history) - 1
        if done == len(self.steps_deg):
            return None
        speed = _each(self.speed_deg_s, done)
        return Waypoint(
            rad(self.steps_deg[done]),
            f"step_{done + 1}",
            speed_rad_s=None if speed is None else rad(speed),
            settle_s=_each(self.dwell_s, done),
        )

    def expected_motions(self) -> int:
        """As many as there are steps."""
        return len(self.steps_deg)


def _each(value: Each, number: int) -> float | None:
    return value[number] if isinstance(value, list | tuple) else value
