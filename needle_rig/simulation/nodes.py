"""The three nodes in Python: counts in, bytes out, at their own clock in µs. No node knows the plant."""

from __future__ import annotations

import math
from collections.abc import Sequence

from needle_rig.config.schema import DriveSection
from needle_rig.records import DriveFault, DriveState
from needle_rig.simulation.drive_guard import DriveGuard, guard_settings
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
    """Velocity commands to the motor, encoder to CAN, behind a `DriveGuard`."""

    def __init__(self, codec: CanCodec, limits: DriveSection) -> None:
        self._codec = codec
        self.guard = DriveGuard(guard_settings(limits))
        self._counter = 0
        self._command_counter: int | None = None

    @property
    def state(self) -> DriveState:
        """State of the guard."""
        return self.guard.state

    @property
    def faults(self) -> DriveFault:
        """Why it stands in FAULT."""
        return self.guard.faults

    @property
    def powered(self) -> bool:
        """Whether the motor is on."""
        return self.guard.powered

    def receive(self, now_us: int, frame_id: int, data: bytes) -> None:
        """A frame seen on the bus; a command counts when its counter moved on by one to three."""
        content = self._codec.decode(frame_id, data)
        if isinstance(content, TorqueStatus) and content.state == TORQUE_OK:
            self.guard.torque(now_us, content.torque_nm)
        elif isinstance(content, DriveCommand):
            last, self._command_counter = self._command_counter, content.counter
            if last is not None and 1 <= (content.counter - last) % COUNTER_MODULUS <= 3:
                self.guard.receive(now_us, content.command, content.heartbeat)
        elif content is None and frame_id in (DRIVE_COMMAND_ID, TORQUE_STATUS_ID):
            self.guard.damaged()

    def step(self, now_us: int, encoder_counts: int) -> tuple[tuple[int, bytes], float]:
        """The status frame of one sample, and the velocity in rad/s that the motor may have now."""
        angle_rad = rad(encoder_counts / ENCODER_COUNTS_PER_DEG)
        velocity_rad_s = self.guard.step(now_us, angle_rad)
        self._counter += 1
        status = self._codec.encode_drive(angle_rad, self.state, self.faults, self._counter, now_us * 1e-6)
        return (DRIVE_STATUS_ID, status), velocity_rad_s
