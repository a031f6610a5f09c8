"""The drive's velocity loop in Python: a ramp, and a correction for what the shaft lacks."""

from __future__ import annotations

from needle_rig.simulation.drive.motion_monitor import MotionMonitor
from needle_rig.units import nmm, rad

ACCELERATION = 7_200_000
FOLLOWING_GAIN = 30
"""Above the firmware's 20, in the place of its term for the velocity."""
MEASURED_SHARE, PACE_SHARE = 0.38, 0.12
LOAD_PER_NMM, LEAST = 15_000.0, 5500.0
UNIT_RAD_S = rad(1e-4)


class VelocityLoop:
    """Behind a guard's monitor, as firmware/core/nr_drive.c: 1e-4 deg/s inside, rad/s outside.

    The correction is bounded by what the encoder confirms and the load explains, as there; it goes by the
    place that is lacking alone, since the velocity between two readings 5 ms apart is too late to act on.
    """

    def __init__(self, monitor: MotionMonitor) -> None:
        self._monitor = monitor
        self._angle_rad: float | None = None
        self.asked = 0
        """The ramp's velocity now, in 1e-4 deg/s."""

    def step(self, permitted_rad_s: float, angle_rad: float, torque_nm: float, dt_s: float) -> float:
        """What the motor is asked for from now on, rad/s, `dt_s` after the last step."""
        measured = 0.0 if self._angle_rad is None or dt_s <= 0.0 else (angle_rad - self._angle_rad) / dt_s
        self._angle_rad = angle_rad
        wanted, change = round(permitted_rad_s / UNIT_RAD_S), round(ACCELERATION * dt_s)
        self.asked = min(max(wanted, self.asked - change), self.asked + change)
        if self.asked == 0 and self._monitor.resting:
            return 0.0
        bound = (
            MEASURED_SHARE * abs(measured) / UNIT_RAD_S
            + PACE_SHARE * self._monitor.pace_q8 / 256
            + LOAD_PER_NMM * abs(nmm(torque_nm))
            + LEAST
        )
        lacking = FOLLOWING_GAIN * self._monitor.following * 1e-6
        return (self.asked + min(max(lacking, -bound), bound)) * UNIT_RAD_S

    def reset(self) -> None:
        """The motor is off."""
        self.asked = 0
        self._angle_rad = None
