"""How old the links are to a host that may itself have been late."""

from __future__ import annotations

import math
from dataclasses import replace

from needle_rig.control.faults import Fault
from needle_rig.control.limits import Limits, heard_age_s, slow_host_fault
from needle_rig.records import Measurement

LISTENING_PERIODS = 2.0
"""Of one longer tick only so much counts as time in which the links were listened to; a second in a row is a
host that is too slow."""


class Listening:
    """Follows the ages of the three links from tick to tick."""

    def __init__(self, tick_hz: float) -> None:
        self._listening_s = LISTENING_PERIODS / tick_hz
        self._ages_s: tuple[float, ...] = (math.inf, math.inf, math.inf)
        self._late_ticks = 0

    def judged(self, measurement: Measurement, dt_s: float) -> Measurement:
        """`measurement` with the ages that may be held against its links; see `heard_age_s`."""
        self._late_ticks = self._late_ticks + 1 if dt_s > self._listening_s else 0
        ages_s = (measurement.torque_age_s, measurement.hall_age_s, measurement.drive_age_s)
        torque_s, hall_s, drive_s = self._ages_s
        if (
            dt_s <= self._listening_s
            and ages_s[0] <= torque_s + dt_s
            and ages_s[1] <= hall_s + dt_s
            and ages_s[2] <= drive_s + dt_s
        ):  # a host that keeps time, as nearly always: heard_age_s would say the same
            self._ages_s = ages_s
            return measurement
        torque_s, hall_s, drive_s = self._ages_s = tuple(
            heard_age_s(before_s, age_s, dt_s, self._listening_s)
            for before_s, age_s in zip(self._ages_s, ages_s, strict=True)
        )
        if self._ages_s == ages_s:
            return measurement
        return replace(measurement, torque_age_s=torque_s, hall_age_s=hall_s, drive_age_s=drive_s)

    def fault(self, measurement: Measurement, dt_s: float, limits: Limits) -> Fault | None:
        """A link that a host whose ticks come late in a row cannot see die in time, or None."""
        return slow_host_fault(measurement, dt_s, limits) if self._late_ticks > 1 else None
