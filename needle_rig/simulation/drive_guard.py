"""The drive's own guard in virtual time: states and reasons as in the firmware, without its frames."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needle_rig.records import STOP, Command, DriveFault, DriveState
from needle_rig.units import nm, rad

TEMPORARY = DriveFault.COMMAND_AGE | DriveFault.FRAME | DriveFault.TORQUE_AGE


@dataclass(frozen=True)
class GuardSettings:
    """The firmware's defaults: SI."""

    command_age_s: float = 0.05
    still_s: float = 0.1
    """Rest before a latching fault may be cleared."""
    velocity_rad_s: float = rad(90.0)
    angle_rad: float = rad(722.0)
    torque_nm: float = nm(2.0)


class DriveGuard:
    """SILENT after boot; READY after a clear; RUNNING while enabled; FAULT until a clear."""

    def __init__(self, settings: GuardSettings | None = None) -> None:
        self.state = DriveState.SILENT
        self.faults = DriveFault.NONE
        self._settings = settings or GuardSettings()
        self._command = STOP
        self._age_s = math.inf
        self._still_s = math.inf
        self._clear_asked = False

    def receive(self, command: Command) -> None:
        """A valid command; a clear counts once, when it follows a command without one."""
        asks = command.clear and not command.enable and command.velocity_rad_s == 0.0
        self._clear_asked = self._clear_asked or (asks and not self._command.clear)
        self._command = command
        self._age_s = 0.0

    def step(self, dt_s: float, angle_rad: float, torque_nm: float) -> tuple[float, bool]:
        """Velocity that the motor may have for the next `dt_s`, and whether it is powered."""
        present = self._causes(angle_rad, torque_nm)
        if self.state in (DriveState.SILENT, DriveState.FAULT):
            if self._clear_asked:
                self._try_clear(present)
        elif self.state is DriveState.READY and not self._command.enable:
            if present & DriveFault.COMMAND_AGE:
                self.state = DriveState.SILENT
        elif present:
            self.faults |= present
            self.state = DriveState.FAULT
        else:
            self.state = DriveState.RUNNING if self._command.enable else DriveState.READY
        self._clear_asked = False
        self._age_s += dt_s
        running = self.state is DriveState.RUNNING
        velocity = self._command.velocity_rad_s if running else 0.0
        self._still_s = 0.0 if velocity else self._still_s + dt_s
        return velocity, running

    def _causes(self, angle_rad: float, torque_nm: float) -> DriveFault:
        settings = self._settings
        found = DriveFault.NONE
        if self._age_s > settings.command_age_s:
            found |= DriveFault.COMMAND_AGE
        if abs(self._command.velocity_rad_s) > settings.velocity_rad_s:
            found |= DriveFault.VELOCITY
        outward = self._command.velocity_rad_s * angle_rad >= 0.0
        if abs(angle_rad) > settings.angle_rad and outward:
            found |= DriveFault.ANGLE
        if abs(torque_nm) > settings.torque_nm:
            found |= DriveFault.TORQUE_TRIP
        return found

    def _try_clear(self, present: DriveFault) -> None:
        latched = bool(self.faults & ~TEMPORARY)
        if not present & ~DriveFault.ANGLE and (not latched or self._still_s >= self._settings.still_s):
            self.state, self.faults = DriveState.READY, DriveFault.NONE
