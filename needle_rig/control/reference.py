"""Whether the drive knows its zero, and what gives it: by a person, the Hall angles or an index mark.

A drive node counts from where it stood when it was switched on. At the first look its zero is confirmed when
encoder and Hall angles agree; a node that starts again later has lost it, and says so.
"""

from __future__ import annotations

import math

from needle_rig.control.faults import Fault, FaultName
from needle_rig.control.shaft import Spring, base_by_hall_rad
from needle_rig.errors import BadInput
from needle_rig.records import Measurement
from needle_rig.units import deg, rad

TOLD_RAD = rad(0.2)
"""The drive took its reference when its angle is this near: what its encoder may flicker by."""
JUMP_RAD = rad(30.0)
FASTEST_RAD_S = rad(1000.0)
"""No hand and no motor of a rig turns faster: an angle that moves on by more, and by JUMP_RAD on top, counts
from another zero. A drive of another make, which does not say that it started again, shows it by this."""
TELLING_S = 1.0
"""How long a drive may take for it: two hundred ticks."""


class Reference:
    """The zero of one drive. `wanted_rad` is what it is being told; None when there is nothing to tell."""

    def __init__(self, spring: Spring | None, tolerance_rad: float) -> None:
        """`spring` is None where no Hall sensor sees the shaft: then a person must confirm the zero."""
        self._spring = spring
        self._tolerance_rad = tolerance_rad
        self._seen = False
        self._told_s = 0.0
        self._last: Measurement | None = None
        self._jumped = ""
        self.wanted_rad: float | None = None
        self.searching = False
        """An index mark is being looked for: motion without a zero is meant."""

    def step(self, now: Measurement, dt_s: float, *, can_confirm: bool = True) -> Fault | None:
        """One tick in which the drive was heard; a latching fault while the zero is lost or not taken.

        `can_confirm` says whether torque and Hall angles were heard too: a first look waits for them.
        """
        last, self._last = self._last or now, now
        if self.wanted_rad is not None:
            told = self._told_s > 0.0
            if told and now.referenced and abs(now.base_angle_rad - self.wanted_rad) <= TOLD_RAD:
                self.wanted_rad, self._seen = None, True
                return None
            self._told_s += dt_s
            if self._told_s <= TELLING_S:
                return None
            self.wanted_rad = None
            return self._lost(
                "the drive does not take the angle that it was given; stop it and look at the bus"
            )
        jump_rad = abs(now.base_angle_rad - last.base_angle_rad)
        between_s = max((now.time_s - now.drive_age_s) - (last.time_s - last.drive_age_s), 0.0)
        if jump_rad > JUMP_RAD + FASTEST_RAD_S * between_s:
            self._jumped = (
                f"the drive's angle went from {deg(last.base_angle_rad):.1f}° to"
                f" {deg(now.base_angle_rad):.1f}° at once: it counts from another zero"
            )
        if self._jumped and not self.searching:
            return self._lost(self._jumped)
        if now.referenced or self.searching:
            self._seen = self._seen or now.referenced
            return None
        if not self._seen and not can_confirm:
            return None
        if not self._seen and self._confirmed(now):
            self.tell(now.base_angle_rad)
            return None
        return self._lost(self._what_is_known(now))

    def tell(self, angle_rad: float) -> None:
        """The base stands at `angle_rad`: tell the drive so in the next ticks."""
        self.wanted_rad, self._told_s, self.searching = angle_rad, 0.0, False
        self._jumped = ""

    def by_hall_rad(self, now: Measurement) -> float:
        """The base's angle by torque and first Hall sensor; BadInput where there is no sensor."""
        if self._spring is None:
            raise BadInput("this rig has no Hall sensor to find its zero by; give --here, or --by index")
        return base_by_hall_rad(now, self._spring)

    def by_index_rad(self, now: Measurement, index_rad: float) -> float:
        """The base's angle now, given the angle of the index mark that just passed, within one turn."""
        if self._spring is not None:
            passed_rad = self.by_hall_rad(now) - (now.base_angle_rad - now.index_rad)
            index_rad += math.tau * round((passed_rad - index_rad) / math.tau)
        return index_rad + now.base_angle_rad - now.index_rad

    def _confirmed(self, now: Measurement) -> bool:
        if self._spring is None:
            return False
        return abs(self.by_hall_rad(now) - now.base_angle_rad) <= self._tolerance_rad

    def _what_is_known(self, now: Measurement) -> str:
        encoder = f"its encoder says {deg(now.base_angle_rad):.1f}°"
        if self._spring is None:
            return f"the drive node was switched on and {encoder}, which no Hall sensor confirms"
        return (
            f"the drive node was switched on and does not know its zero: {encoder}, the Hall angles"
            f" {deg(self.by_hall_rad(now)):.1f}°"
        )

    def _lost(self, text: str) -> Fault:
        return Fault(
            FaultName.REFERENCE_LOST,
            "drive",
            f"{text}; find it again: needle-rig home --by hall, --by index, or --here ANGLE if you know it",
            latching=True,
        )
