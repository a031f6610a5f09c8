"""The drive's own guard in Python: decides as the firmware's does, but for the motor's rate and stall."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.config.schema import DriveSection
from needle_rig.records import STOP, Command, DriveFault, DriveState
from needle_rig.units import nm, rad

TEMPORARY = DriveFault.COMMAND_AGE | DriveFault.FRAME | DriveFault.TORQUE_AGE
VELOCITY_MARGIN = 1.5


@dataclass(frozen=True)
class GuardSettings:
    """The firmware's defaults: µs and SI. See firmware/core/nr_guard.h."""

    command_age_us: int = 50_000
    heartbeat_us: int = 50_000
    torque_age_us: int = 50_000
    still_us: int = 100_000
    """Rest before a latching fault may be cleared."""
    velocity_rad_s: float = rad(90.0)
    angle_rad: float = rad(720.0)
    """Further out the motor is held; beyond the margin on top it is a fault."""
    angle_margin_rad: float = rad(2.0)
    torque_nm: float = nm(2.0)
    damaged_frames: int = 10
    damaged_window_us: int = 40_000


def guard_settings(limits: DriveSection) -> GuardSettings:
    """The guard behind a host with these limits, which are narrower."""
    return GuardSettings(
        velocity_rad_s=rad(limits.velocity_limit_deg_s) * VELOCITY_MARGIN,
        angle_rad=rad(limits.angle_limit_deg),
        torque_nm=nm(limits.torque_limit_nmm),
    )


class DriveGuard:
    """SILENT after boot; READY after a clear; RUNNING while enabled; FAULT until a clear.

    All times are of the node's clock in µs.
    """

    def __init__(self, settings: GuardSettings | None = None) -> None:
        self.state = DriveState.SILENT
        self.faults = DriveFault.NONE
        self.command_us: int | None = None
        """When the newest command came."""
        self._settings = settings or GuardSettings()
        self._command = STOP
        self._heartbeat: int | None = None
        self._heartbeat_us = 0
        self._clear_asked = False
        self._torque_nm = 0.0
        self._torque_us: int | None = None
        self._damaged = 0
        self._window_us: int | None = None
        self._still_since_us = 0
        self._permitted_rad_s = 0.0

    @property
    def powered(self) -> bool:
        """Whether the motor is on."""
        return self.state is DriveState.RUNNING

    def receive(self, now_us: int, command: Command, heartbeat: int | None = None) -> None:
        """A command in sequence; without a `heartbeat` its host is taken to be alive.

        A clear stands until it is granted or the bit goes, and counts when it follows a command without one.
        """
        if heartbeat is None or heartbeat != self._heartbeat:
            self._heartbeat, self._heartbeat_us = heartbeat, now_us
        if command != Command(clear=True):
            self._clear_asked = False
        elif not self._command.clear:
            self._clear_asked = True
        self._command, self.command_us = command, now_us

    def torque(self, now_us: int, torque_nm: float) -> None:
        """A good torque at the base."""
        self._torque_nm, self._torque_us = torque_nm, now_us

    def damaged(self) -> None:
        """A frame for the drive whose checksum was wrong."""
        self._damaged += 1

    def step(self, now_us: int, angle_rad: float) -> float:
        """Once a tick: the velocity in rad/s that the motor may have now; 0 unless RUNNING."""
        causes = self._causes(now_us, angle_rad)
        self._judge_window(now_us)
        if self._permitted_rad_s:
            self._still_since_us = now_us
        if self.state in (DriveState.READY, DriveState.RUNNING):
            self._clear_asked = False
        if self.state in (DriveState.SILENT, DriveState.FAULT):
            if self._clear_asked:
                self._try_clear(now_us, causes)
        elif self.state is DriveState.READY and not self._command.enable:
            if causes & DriveFault.COMMAND_AGE:
                self.state = DriveState.SILENT
        elif causes:
            self.state, self.faults = DriveState.FAULT, causes
        else:
            self.state = DriveState.RUNNING if self._command.enable else DriveState.READY
        self._permitted_rad_s = self._permitted(angle_rad) if self.powered else 0.0
        return self._permitted_rad_s

    def _causes(self, now_us: int, angle_rad: float) -> DriveFault:
        """What forbids motion now, whatever the state."""
        settings, velocity_rad_s = self._settings, self._command.velocity_rad_s
        found = DriveFault.NONE
        if self.command_us is None or now_us - self.command_us > settings.command_age_us:
            found |= DriveFault.COMMAND_AGE
        elif now_us - self._heartbeat_us > settings.heartbeat_us:
            found |= DriveFault.HEARTBEAT
        if self._torque_us is None or now_us - self._torque_us > settings.torque_age_us:
            found |= DriveFault.TORQUE_AGE
        elif abs(self._torque_nm) > settings.torque_nm:
            found |= DriveFault.TORQUE_TRIP
        if abs(velocity_rad_s) > settings.velocity_rad_s:
            found |= DriveFault.VELOCITY
        # Out of range it may still turn back in.
        if (
            abs(angle_rad) > settings.angle_rad + settings.angle_margin_rad
            and velocity_rad_s * angle_rad >= 0.0
        ):
            found |= DriveFault.ANGLE
        if self._damaged > settings.damaged_frames:
            found |= DriveFault.FRAME
        return found

    def _judge_window(self, now_us: int) -> None:
        if self._window_us is None:
            self._window_us, self._damaged = now_us, 0
        elif now_us - self._window_us >= self._settings.damaged_window_us:
            self._window_us = None

    def _try_clear(self, now_us: int, causes: DriveFault) -> None:
        latched = bool(self.faults & ~TEMPORARY)
        still = now_us - self._still_since_us >= self._settings.still_us
        if not causes & ~(DriveFault.FRAME | DriveFault.ANGLE) and (not latched or still):
            self.state, self.faults, self._damaged = DriveState.READY, DriveFault.NONE, 0

    def _permitted(self, angle_rad: float) -> float:
        wanted_rad_s, limit_rad = self._command.velocity_rad_s, self._settings.angle_rad
        outward = (wanted_rad_s > 0.0 and angle_rad >= limit_rad) or (
            wanted_rad_s < 0.0 and angle_rad <= -limit_rad
        )
        return 0.0 if outward else wanted_rad_s
