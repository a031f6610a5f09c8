"""The drive's own guard in Python: decides as the firmware's does (firmware/core/nr_guard.c)."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.config.schema import DriveSection
from needle_rig.records import COMMAND_AGE_S, STOP, TEMPORARY, Command, DriveFault, DriveState
from needle_rig.simulation.drive.motion_monitor import MotionMonitor, Verdict
from needle_rig.units import deg, nm, rad

ENDS_READY = DriveFault.IDLE_MOTION | DriveFault.EMERGENCY_STOP
VELOCITY_MARGIN = 1.5


@dataclass(frozen=True)
class GuardSettings:
    """The firmware's defaults: µs and SI. See firmware/core/nr_guard.h."""

    command_age_us: int = round(COMMAND_AGE_S * 1e6)
    heartbeat_us: int = 50_000
    torque_age_us: int = 50_000
    still_us: int = 100_000
    """Rest before a latching fault may be cleared or a reference taken, and time from its newest cause to the
    sight that a clear tells."""
    still_mdeg: int = 10
    contact_us: int = 20_000
    resync_us: int = 20_000
    foreign_us: int = 50_000
    foreign_commands: int = 3
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
        self.supply = False
        """The safe-torque-off line lets the motor have its supply: in READY and RUNNING."""
        self.referenced = False
        self.command_us: int | None = None
        """When the newest command came."""
        self.motion = MotionMonitor()
        self._settings = settings or GuardSettings()
        self._command = STOP
        self._newest: tuple[Command, int, int] | None = None
        self._counter = self._heartbeat = 0
        self._sequence_us: int | None = None
        self._heartbeat_us = 0
        self._foreign_us = 0
        self._clear_asked = self._acknowledged = False
        self._sight_us = self._cause_us = 0
        self._torque_nm = 0.0
        self._torque_us: int | None = None
        self._damaged = 0
        self._window_us: int | None = None
        self._step_us = 0
        self._still_mdeg = 0
        self._still_since_us = 0
        self._supply_us = 0
        self._permitted_rad_s = 0.0

    @property
    def torque_nm(self) -> float:
        """The newest good torque at the base."""
        return self._torque_nm

    def receive(self, now_us: int, command: Command, counter: int, heartbeat: int) -> bool:
        """A command whose checksum was right; False when it is not the next of its master, and not obeyed.

        A clear stands until it is granted or the bit goes, and counts when it follows a command without one.
        """
        counted, beaten = (counter - self._counter) % 16, (heartbeat - self._heartbeat) % 65536
        if self._sequence_us is None or not (1 <= counted <= 3 and beaten <= 3):
            self._out_of_sequence(now_us, command, counter, heartbeat)
            return False
        if self.command_us is None or beaten:
            self._heartbeat_us = now_us
        self._counter, self._heartbeat, self._sequence_us = counter % 16, heartbeat % 65536, now_us
        if not command.clear or command.enable or command.velocity_rad_s:
            self._clear_asked = False
        elif not self._command.clear:
            self._clear_asked, self._acknowledged = True, command.acknowledge
            self._sight_us = now_us - round(command.sight_s * 1e6)
        self._command, self.command_us = command, now_us
        self._newest = (command, self._counter, self._heartbeat)
        return True

    def torque(self, now_us: int, torque_nm: float) -> None:
        """A good torque at the base."""
        self._torque_nm, self._torque_us = torque_nm, now_us

    def damaged(self) -> None:
        """A frame for the drive whose checksum was wrong."""
        self._damaged += 1

    def reference(self, now_us: int, heartbeat: int, angle_rad: float) -> bool:
        """Whether the shaft stands at `angle_rad` from now on, as one who knows the newest heartbeat says."""
        known = (
            self.command_us is not None
            and now_us - self.command_us <= self._settings.command_age_us
            and self._newest is not None
            and heartbeat % 65536 == self._newest[2]
        )
        if not known or self.state is DriveState.RUNNING or not self._still(now_us):
            return False
        self.referenced = True
        self._still_mdeg = mdeg(angle_rad)
        self.motion.rename(self._still_mdeg)
        return True

    def step(self, now_us: int, angle_rad: float, asked: int = 0, *, emergency_stop: bool = False) -> float:
        """Once a tick: the velocity in rad/s that the motor may have now; 0 unless RUNNING.

        `asked` is what the drive asked of its motor since the last step, in 1e-4 deg/s.
        """
        elapsed_us, self._step_us = now_us - self._step_us, now_us
        causes = self._causes(now_us, angle_rad, emergency_stop)
        causes |= self._judge_motion(elapsed_us, mdeg(angle_rad), asked)
        self._forget(now_us, elapsed_us)
        if self._permitted_rad_s or abs(mdeg(angle_rad) - self._still_mdeg) > self._settings.still_mdeg:
            self._still_since_us, self._still_mdeg = now_us, mdeg(angle_rad)
        self._change_state(now_us, causes)
        supply = self.state in (DriveState.READY, DriveState.RUNNING)
        if supply and not self.supply:
            self._supply_us = now_us
        self.supply = supply
        self._permitted_rad_s = self._permitted(angle_rad) if self.state is DriveState.RUNNING else 0.0
        return self._permitted_rad_s

    def _out_of_sequence(self, now_us: int, command: Command, counter: int, heartbeat: int) -> None:
        settings = self._settings
        if (command, counter % 16, heartbeat % 65536) == self._newest:
            return
        if self._foreign_us <= settings.foreign_commands * settings.foreign_us:
            self._foreign_us += settings.foreign_us
        if self._sequence_us is None or now_us - self._sequence_us > settings.resync_us:
            self._counter, self._heartbeat, self._sequence_us = counter % 16, heartbeat % 65536, now_us

    def _causes(self, now_us: int, angle_rad: float, emergency_stop: bool) -> DriveFault:
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
        if self._foreign_us > settings.foreign_commands * settings.foreign_us:
            found |= DriveFault.MASTER
        if emergency_stop:
            found |= DriveFault.EMERGENCY_STOP
        return found

    def _judge_motion(self, elapsed_us: int, angle_mdeg: int, asked: int) -> DriveFault:
        """What the shaft does against what was asked of it; a hand may turn it while the motor is off."""
        if self.state in (DriveState.SILENT, DriveState.FAULT):
            self.motion.rest(angle_mdeg)
            return DriveFault.NONE
        verdict = self.motion.step(elapsed_us, angle_mdeg, asked)
        if verdict is not Verdict.FOLLOWS and self.state is DriveState.READY:
            return DriveFault.IDLE_MOTION
        return _MOTION_FAULTS[verdict]

    def _forget(self, now_us: int, elapsed_us: int) -> None:
        self._foreign_us = max(self._foreign_us - elapsed_us, 0)
        if self._window_us is None or now_us - self._window_us >= self._settings.damaged_window_us:
            self._window_us, self._damaged = now_us, 0

    def _still(self, now_us: int) -> bool:
        return now_us - self._still_since_us >= self._settings.still_us

    def _try_clear(self, now_us: int, causes: DriveFault) -> None:
        may = not self._latched or (self._acknowledged and self._still(now_us))
        if not causes & ~(DriveFault.FRAME | DriveFault.ANGLE) and may:
            self.state, self.faults, self._damaged = DriveState.READY, DriveFault.NONE, 0

    @property
    def _latched(self) -> bool:
        return bool(self.faults & ~TEMPORARY)

    def _latch(self, now_us: int, causes: DriveFault) -> None:
        if self.state is DriveState.SILENT and causes & DriveFault.EMERGENCY_STOP:
            self.state = DriveState.FAULT
        if self.state is not DriveState.FAULT:
            return
        latching = causes & ~TEMPORARY
        self.faults |= latching
        if latching & ~DriveFault.ANGLE:
            self._cause_us = now_us
        if self._latched and self._sight_us - self._cause_us < self._settings.still_us:
            self._clear_asked = False

    def _change_state(self, now_us: int, causes: DriveFault) -> None:
        self._latch(now_us, causes)
        if self.state in (DriveState.SILENT, DriveState.FAULT):
            if self._clear_asked:
                self._try_clear(now_us, causes)
            return
        self._clear_asked = False
        waits = self.state is DriveState.READY and not self._command.enable
        reasons = causes & ENDS_READY if waits else causes
        if reasons:
            self.state, self.faults, self._cause_us = DriveState.FAULT, reasons, now_us
        elif waits and causes & DriveFault.COMMAND_AGE:
            self.state = DriveState.SILENT
        elif not self._command.enable:
            self.state = DriveState.READY
        elif now_us - self._supply_us >= self._settings.contact_us:
            self.state = DriveState.RUNNING

    def _permitted(self, angle_rad: float) -> float:
        wanted_rad_s, limit_rad = self._command.velocity_rad_s, self._settings.angle_rad
        outward = (wanted_rad_s > 0.0 and angle_rad >= limit_rad) or (
            wanted_rad_s < 0.0 and angle_rad <= -limit_rad
        )
        return 0.0 if outward else wanted_rad_s


_MOTION_FAULTS = {
    Verdict.FOLLOWS: DriveFault.NONE,
    Verdict.STALLS: DriveFault.STALL,
    Verdict.RUNS: DriveFault.RUNAWAY,
    Verdict.AGAINST: DriveFault.DIRECTION,
    Verdict.UNASKED: DriveFault.IDLE_MOTION,
}


def mdeg(angle_rad: float) -> int:
    """The firmware's unit of angles."""
    return round(deg(angle_rad) * 1000.0)
