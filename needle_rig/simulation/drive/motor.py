"""The base motor: a velocity command becomes an angle through gain, dead time, lag, and droop under load."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True)
class MotorSettings:
    """SI. `droop_rad_s_per_nm` is the speed lost for each N·m at the base; `load_nm` a constant extra."""

    gain: float = 1.0
    delay_s: float = 0.0
    time_constant_s: float = 0.0
    droop_rad_s_per_nm: float = 0.0
    load_nm: float = 0.0


class Motor:
    """dv/dt = (gain · u(t − delay) − droop · torque − v) / time constant; braked, it runs down to rest."""

    def __init__(self, settings: MotorSettings, angle_rad: float = 0.0) -> None:
        self.settings = settings
        self.angle_rad = angle_rad
        self.velocity_rad_s = 0.0
        self._time_s = 0.0
        self._wish: tuple[float, bool] = (0.0, False)
        self._coming: deque[tuple[float, float, bool]] = deque()

    def turn(self, velocity_rad_s: float, *, powered: bool = True) -> None:
        """A new command from now on; not powered means braked: no speed, no droop."""
        if self._coming:
            _, velocity, power = self._coming[-1]
            newest = (velocity, power)
        else:
            newest = self._wish
        if (velocity_rad_s, powered) != newest:
            self._coming.append((self._time_s + self.settings.delay_s, velocity_rad_s, powered))

    def turn_now(self, velocity_rad_s: float, *, powered: bool) -> None:
        """Like `turn`, without the dead time, whatever was on its way: a hand, or a supply cut off."""
        self._coming.clear()
        self._wish = (velocity_rad_s, powered)

    def advance(self, dt_s: float, torque_nm: float) -> list[tuple[float, float]]:
        """Move on by `dt_s` with the needle's torque on the base; [(time since the call, angle)] at kinks."""
        end_s = self._time_s + dt_s
        path: list[tuple[float, float]] = []
        start_s = self._time_s
        while self._coming and self._coming[0][0] <= end_s:
            at_s, velocity, powered = self._coming.popleft()
            if at_s > self._time_s:
                self._run(at_s - self._time_s, torque_nm)
                self._time_s = at_s
                path.append((at_s - start_s, self.angle_rad))
            self._wish = (velocity, powered)
        if end_s > self._time_s:
            self._run(end_s - self._time_s, torque_nm)
            self._time_s = end_s
            path.append((dt_s, self.angle_rad))
        return path

    def _run(self, dt_s: float, torque_nm: float) -> None:
        velocity, powered = self._wish
        settings = self.settings
        load = settings.droop_rad_s_per_nm * (torque_nm + settings.load_nm)
        final = settings.gain * velocity - load if powered else 0.0
        if settings.time_constant_s <= 0.0:
            self.velocity_rad_s = final
            self.angle_rad += final * dt_s
            return
        decay = math.exp(-dt_s / settings.time_constant_s)
        self.angle_rad += final * dt_s + (self.velocity_rad_s - final) * settings.time_constant_s * (
            1 - decay
        )
        self.velocity_rad_s = final + (self.velocity_rad_s - final) * decay
