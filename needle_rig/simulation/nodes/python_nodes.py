"""The three nodes in Python: counts in, bytes out, at their own clock in µs. No node knows the plant."""

from __future__ import annotations

import math
from collections.abc import Sequence

from needle_rig.config.schema import DriveSection
from needle_rig.records import DriveFault, DriveState
from needle_rig.simulation.drive.drive_guard import DriveGuard, guard_settings
from needle_rig.simulation.drive.velocity_loop import VelocityLoop
from needle_rig.simulation.nodes.front_end import (
    ENCODER_COUNTS_PER_DEG,
    TORQUE_COUNTS_PER_NMM,
    TORQUE_FULL_SCALE,
)
from needle_rig.simulation.nodes.slcan_hub import Frame
from needle_rig.units import deg, nm, rad
from needle_rig.version import VERSION
from needle_rig.wire.can_frames import (
    CALIBRATION_IDS,
    DRIVE_COMMAND_ID,
    DRIVE_HEALTH_ID,
    DRIVE_REFERENCE_ID,
    DRIVE_STATUS_ID,
    FIRMWARE_IDS,
    TORQUE_OK,
    TORQUE_STATUS_ID,
    CanCodec,
    DriveCommand,
    DriveHealth,
    DriveReference,
    NodeCalibration,
    NodeFirmware,
    TorqueStatus,
)
from needle_rig.wire.hall_frames import encode_hall

_SATURATED = 2
HEALTH_PERIOD_US = 10_000
INTRODUCTION_PERIOD_US = 500_000


class Introduction:
    """What a node says of itself, as firmware/core/nr_identity.c: two frames that take turns."""

    def __init__(self, codec: CanCodec, node: str) -> None:
        self._codec, self._node = codec, node
        self.protocol: int | None = max(codec.protocols)
        """None sends nothing, as firmware did before there were such frames."""
        self.reset()

    def reset(self) -> None:
        """The node restarts."""
        self._due_us: int | None = None
        self._sent = 0

    def step(self, now_us: int) -> tuple[Frame, ...]:
        """The frame that is due, if one is."""
        if self.protocol is None or (self._due_us is not None and now_us < self._due_us):
            return ()
        self._due_us = now_us + INTRODUCTION_PERIOD_US
        turn, second = divmod(self._sent, 2)
        self._sent += 1
        if second:
            calibration = NodeCalibration(self._node, self.protocol, None, turn)
            return ((CALIBRATION_IDS[self._node], self._codec.encode_calibration(calibration)),)
        firmware = NodeFirmware(self._node, self.protocol, VERSION, 0, turn)
        return ((FIRMWARE_IDS[self._node], self._codec.encode_firmware(firmware)),)


class TorqueNode:
    """Load-cell converter to CAN."""

    def __init__(self, codec: CanCodec) -> None:
        self._codec = codec
        self.introduction = Introduction(codec, "torque")
        self._counter = 0

    def step(self, now_us: int, torque_counts: int) -> tuple[Frame, ...]:
        """The frames of one sample."""
        self._counter += 1
        state = _SATURATED if abs(torque_counts) >= TORQUE_FULL_SCALE else TORQUE_OK
        torque_nm = nm(torque_counts / TORQUE_COUNTS_PER_NMM)
        status = self._codec.encode_torque(torque_nm, state, self._counter, now_us * 1e-6)
        return ((TORQUE_STATUS_ID, status), *self.introduction.step(now_us))


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
    """Velocity commands to the motor, encoder and health to CAN, behind a `DriveGuard`."""

    def __init__(self, codec: CanCodec, limits: DriveSection) -> None:
        self._codec = codec
        self._settings = guard_settings(limits)
        self.introduction = Introduction(codec, "drive")
        self.reset(0)

    def reset(self, now_us: int) -> None:
        """The node restarts: silent, its counts from zero."""
        self.guard = DriveGuard(self._settings)
        self._loop = VelocityLoop(self.guard.motion)
        self._boot_us = self._step_us = now_us
        self.introduction.reset()
        self._zero_counts: int | None = None
        self._angle_rad = 0.0
        self._counts = 0
        self._index_rad, self._index_before = math.nan, False
        self._counter = 0
        self._flags: tuple[object, ...] = ()
        """What DRIVE_HEALTH said last of that which is said at once when it changes."""
        self._healths, self._health_us = -1, 0

    @property
    def state(self) -> DriveState:
        """State of the guard."""
        return self.guard.state

    @property
    def faults(self) -> DriveFault:
        """Why it stands in FAULT."""
        return self.guard.faults

    @property
    def supply_on(self) -> bool:
        """Whether the motor may have its supply."""
        return self.guard.supply

    @property
    def powered(self) -> bool:
        """Whether the motor is on."""
        return self.guard.state is DriveState.RUNNING and not (
            self._loop.asked == 0 and self.guard.motion.resting
        )

    def receive(self, now_us: int, frame_id: int, data: bytes) -> None:
        """A frame seen on the bus."""
        content = self._codec.decode(frame_id, data)
        if isinstance(content, TorqueStatus) and content.state == TORQUE_OK:
            self.guard.torque(now_us, content.torque_nm)
        elif isinstance(content, DriveCommand):
            self.guard.receive(now_us, content.command, content.counter, content.heartbeat)
        elif isinstance(content, DriveReference):
            self._refer(now_us, content)
        elif content is None and frame_id in (DRIVE_COMMAND_ID, DRIVE_REFERENCE_ID, TORQUE_STATUS_ID):
            self.guard.damaged()

    def step(
        self, now_us: int, encoder_counts: int, *, index: bool = False, emergency_stop: bool = False
    ) -> tuple[tuple[Frame, ...], float]:
        """The frames of one sample, and the velocity in rad/s that the motor may have now."""
        if self._zero_counts is None:
            self._zero_counts, self._index_before = encoder_counts, index
        self._counts = encoder_counts
        self._angle_rad = rad((encoder_counts - self._zero_counts) / ENCODER_COUNTS_PER_DEG)
        permitted = self.guard.step(now_us, self._angle_rad, self._loop.asked, emergency_stop=emergency_stop)
        if self.state is DriveState.RUNNING:
            dt_s = (now_us - self._step_us) * 1e-6
            velocity_rad_s = self._loop.step(permitted, self._angle_rad, self.guard.torque_nm, dt_s)
        else:
            velocity_rad_s = 0.0
            self._loop.reset()
        self._step_us = now_us
        if index and not self._index_before:
            self._index_rad = self._angle_rad
        self._index_before = index
        self._counter += 1
        status = self._codec.encode_drive(
            self._angle_rad, self.state, self.faults, self._counter, now_us * 1e-6
        )
        health = self._report_health(now_us, emergency_stop)
        return (*health, (DRIVE_STATUS_ID, status), *self.introduction.step(now_us)), velocity_rad_s

    def _refer(self, now_us: int, reference: DriveReference) -> None:
        if self._zero_counts is None:
            return
        if self.guard.reference(now_us, reference.heartbeat, reference.angle_rad):
            self._zero_counts = self._counts - round(deg(reference.angle_rad) * ENCODER_COUNTS_PER_DEG)
            self._index_rad += reference.angle_rad - self._angle_rad

    def _report_health(self, now_us: int, emergency_stop: bool) -> tuple[Frame, ...]:
        """DRIVE_HEALTH when it is due, or when what it says changed."""
        guard, seen = self.guard, math.isfinite(self._index_rad)
        flags = (int(guard.faults) >> 8, guard.supply, emergency_stop, guard.referenced, seen)
        if flags == self._flags and now_us - self._health_us < HEALTH_PERIOD_US:
            return ()
        self._flags, self._health_us = flags, now_us
        self._healths += 1
        health = DriveHealth(
            DriveFault(guard.faults & ~0xFF),
            guard.supply,
            emergency_stop,
            guard.referenced,
            self._index_rad,
            (now_us - self._boot_us) // 1_000_000,
            self._healths,
        )
        return ((DRIVE_HEALTH_ID, self._codec.encode_health(health)),)
