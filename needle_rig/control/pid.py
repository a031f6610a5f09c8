"""The base position loop: simple-pid from angle error to velocity, overdamped, within speed and rate."""

from __future__ import annotations

import math

from simple_pid import PID

BRAKING_SHARE = 0.5
"""Share of the acceleration limit that braking plans with: a drive 30 % too fast brakes 1.3² harder."""
CAPTURE_RAD = math.radians(0.15)
APPROACH_S = 1.0
"""The integral is for load. It works near the setpoint, or when an approach should be long over: integrating
an approach would overshoot."""


class PositionLoop:
    """Turns an unwrapped angle into a velocity command; radians, rad/s, rad/s²."""

    def __init__(self, kp_per_s: float, ki_per_s2: float, kd: float, acceleration_rad_s2: float) -> None:
        self._ki_per_s2 = ki_per_s2
        self._acceleration_rad_s2 = acceleration_rad_s2
        self._pid = PID(kp_per_s, ki_per_s2, kd, sample_time=None)
        self._velocity_rad_s = 0.0
        self._approach_s = 0.0

    def reset(self) -> None:
        """Forget load and speed: the drive stands still."""
        self._pid.reset()
        self._velocity_rad_s = 0.0
        self._approach_s = 0.0

    def step(
        self,
        angle_rad: float,
        setpoint_rad: float,
        speed_rad_s: float,
        dt_s: float,
        feedforward_rad_s: float = 0.0,
    ) -> float:
        """Velocity command for this tick, rad/s; `dt_s` > 0 is the measured time since the last."""
        error = setpoint_rad - angle_rad
        fastest = min(speed_rad_s, self._braking_speed(abs(error)))
        clipped = abs(self._pid.Kp * error) > fastest
        moved = setpoint_rad != self._pid.setpoint
        self._approach_s = 0.0 if clipped or moved else self._approach_s + dt_s
        integrate = not clipped and (abs(error) <= CAPTURE_RAD or self._approach_s >= APPROACH_S)
        self._pid.Ki = self._ki_per_s2 if integrate else 0.0
        self._pid.setpoint = setpoint_rad
        wanted = float(self._pid(angle_rad, dt=dt_s) or 0.0)
        wanted = min(max(wanted, -fastest), fastest) + feedforward_rad_s
        change = self._acceleration_rad_s2 * dt_s
        low, high = self._velocity_rad_s - change, self._velocity_rad_s + change
        self._velocity_rad_s = min(max(wanted, low), high)
        return self._velocity_rad_s

    def _braking_speed(self, distance_rad: float) -> float:
        """Speed from which half the acceleration limit stops in this distance; Kp takes over at the end."""
        braking = BRAKING_SHARE * self._acceleration_rad_s2
        linear = braking / self._pid.Kp**2
        if distance_rad <= linear:
            return math.inf
        return math.sqrt(2.0 * braking * (distance_rad - 0.5 * linear))
