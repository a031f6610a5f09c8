"""The three nodes in Python: counts in, bytes out, at their own clock in µs. No node knows the plant."""

from __future__ import annotations

import math
from collections.abc import Sequence

from needle_rig.config.schema import DriveSection
from needle_rig.records import STOP, Command, DriveFault, DriveState
from needle_rig.simulation.front_end import ENCODER_COUNTS_PER_DEG, TORQUE_COUNTS_PER_NMM, TORQUE_FULL_SCALE
from needle_rig.units import nm, rad
from needle_rig.wire.can_frames import (
    COUNTER_MODULUS,
    DRIVE_COMMAND_ID,
    DRIVE_STATUS_ID,
    TORQUE_OK,
    TORQUE_STATUS_ID,
    CanCodec,
    DriveCommand,
    TorqueStatus,
)
from needle_rig.wire.hall_frames import encode_hall

_SATURATED = 2
_COMMAND_AGE_US = 50_000
_TORQUE_AGE_US = 50_000
_HEARTBEAT_US = 50_000
_DAMAGED_LIMIT = 10
_DAMAGED_WINDOW_US = 20_000
_COMMAND_MARGIN = 1.5
_ANGLE_MARGIN_RAD = rad(2.0)
_CLEARED_ANYWAY = DriveFault.FRAME | DriveFault.ANGLE


class TorqueNode:
    """Load-cell converter to CAN."""

    def __init__(self, codec: CanCodec) -> None:
        self._codec = codec
        self._counter = 0

    def step(self, now_us: int, torque_counts: int) -> tuple[int, bytes]:
        """The frame of one sample."""
        self._counter += 1
        state = _SATURATED if abs(torque_counts) >= TORQUE_FULL_SCALE else TORQUE_OK
        torque_nm = nm(torque_counts / TORQUE_COUNTS_PER_NMM)
        return TORQUE_STATUS_ID, self._codec.encode_torque(torque_nm, state, self._counter, now_us * 1e-6)


class HallNode:
    """Four analogue pairs to serial."""

    def __init__(self) -> None:
        self._counter = 0

    def step(self, now_us: int, pairs: Sequence[tuple[int, int]]) -> bytes:
        """The frame of one sample."""
        self._counter += 1
        angle_rad = [math.atan2(sine, cosine) for sine, cosine in pairs]
        field = [min(round(math.hypot(sine, cosine)), 65535) for sine, cosine in pairs]
        return encode_hall(self._counter, now_us, angle_rad, field)


class DriveNode:
    """Velocity commands to the motor, encoder to CAN; stops by itself when in doubt.

    Silent after boot; a clear (a valid command with only `clear` set, after one without) makes it ready. It
    faults when it runs and the command, the heartbeat or the torque is older than 50 ms, when more than ten
    damaged commands came within 20 ms, or when velocity, angle or torque pass their limit; it moves again
    after a clear, once the cause is gone. A shaft out of range may be cleared: it can then only turn back in.
    """

    def __init__(self, codec: CanCodec, limits: DriveSection) -> None:
        self._codec = codec
        self._velocity_limit_rad_s = rad(limits.velocity_limit_deg_s) * _COMMAND_MARGIN
        self._angle_limit_rad = rad(limits.angle_limit_deg) + _ANGLE_MARGIN_RAD
        self._torque_limit_nm = nm(limits.torque_limit_nmm)
        self.state = DriveState.SILENT
        self.faults = DriveFault.NONE
        self._counter = 0
        self._command = STOP
        self._command_us: int | None = None
        self._command_counter: int | None = None
        self._heartbeat: int | None = None
        self._heartbeat_us = 0
        self._clear_asked = False
        self._torque_nm = 0.0
        self._torque_us: int | None = None
        self._damaged = 0
        self._window_us = 0

    @property
    def powered(self) -> bool:
        """Whether the motor is on."""
        return self.state is DriveState.RUNNING

    def receive(self, now_us: int, frame_id: int, data: bytes) -> None:
        """A frame seen on the bus."""
        content = self._codec.decode(frame_id, data)
        if isinstance(content, TorqueStatus) and content.state == TORQUE_OK:
            self._torque_nm, self._torque_us = content.torque_nm, now_us
        elif isinstance(content, DriveCommand):
            self._obey(content, now_us)
        elif content is None and frame_id == DRIVE_COMMAND_ID:
            self._damaged += 1

    def step(self, now_us: int, encoder_counts: int) -> tuple[tuple[int, bytes], float]:
        """The status frame of one sample, and the velocity in rad/s that the motor may have now."""
        angle_rad = rad(encoder_counts / ENCODER_COUNTS_PER_DEG)
        causes = self._causes(now_us, angle_rad)
        if self.state in (DriveState.SILENT, DriveState.FAULT):
            if self._clear_asked and not causes & ~_CLEARED_ANYWAY:
                self.state, self.faults, self._damaged = DriveState.READY, DriveFault.NONE, 0
        elif self.state is DriveState.READY and not self._command.enable:
            if causes & DriveFault.COMMAND_AGE:
                self.state = DriveState.SILENT
        elif causes:
            self.state, self.faults = DriveState.FAULT, self.faults | causes
        else:
            self.state = DriveState.RUNNING if self._command.enable else DriveState.READY
        self._clear_asked = False
        self._counter += 1
        status = self._codec.encode_drive(angle_rad, self.state, self.faults, self._counter, now_us * 1e-6)
        moving = self.state is DriveState.RUNNING
        return (DRIVE_STATUS_ID, status), self._command.velocity_rad_s if moving else 0.0

    def _obey(self, content: DriveCommand, now_us: int) -> None:
        last, self._command_counter = self._command_counter, content.counter
        if last is None or not 1 <= (content.counter - last) % COUNTER_MODULUS <= 3:
            return
        if content.heartbeat != self._heartbeat:
            self._heartbeat, self._heartbeat_us = content.heartbeat, now_us
        asks = content.command == Command(clear=True)
        self._clear_asked |= asks and not self._command.clear
        self._command, self._command_us = content.command, now_us

    def _causes(self, now_us: int, angle_rad: float) -> DriveFault:
        """What forbids motion now, whatever the state."""
        found = DriveFault.NONE
        if self._command_us is None or now_us - self._command_us > _COMMAND_AGE_US:
            found |= DriveFault.COMMAND_AGE
        elif now_us - self._heartbeat_us > _HEARTBEAT_US:
            found |= DriveFault.HEARTBEAT
        if self._torque_us is None or now_us - self._torque_us > _TORQUE_AGE_US:
            found |= DriveFault.TORQUE_AGE
        elif abs(self._torque_nm) > self._torque_limit_nm:
            found |= DriveFault.TORQUE_TRIP
        velocity_rad_s = self._command.velocity_rad_s
        if abs(velocity_rad_s) > self._velocity_limit_rad_s:
            found |= DriveFault.VELOCITY
        # Out of range it may still turn back in.
        if abs(angle_rad) > self._angle_limit_rad and velocity_rad_s * angle_rad >= 0.0:
            found |= DriveFault.ANGLE
        if now_us - self._window_us > _DAMAGED_WINDOW_US:
            self._window_us, self._damaged = now_us, 0
        if self._damaged > _DAMAGED_LIMIT:
            found |= DriveFault.FRAME
        return found
