"""The base drive on the CAN bus: velocity commands out, encoder, state and faults in."""

from __future__ import annotations

import math
from collections.abc import Callable

from needle_rig.devices.link_clock import LinkClock
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.rig import RawReadings
from needle_rig.wire.can_frames import (
    COUNTER_MODULUS,
    DRIVE_COMMAND_ID,
    HEARTBEAT_MODULUS,
    CanCodec,
    DriveStatus,
)


class DriveCan:
    """Newest status of the drive with its age; every command carries the next counter and heartbeat."""

    def __init__(
        self, codec: CanCodec, send: Callable[[int, bytes], bool], raw: RawReadings | None = None
    ) -> None:
        self._codec = codec
        self._send = send
        self._raw = raw
        self._clock = LinkClock(codec.drive_clock_period_s)
        self._counter = 0
        self._heartbeat = 0
        self.angle_rad = math.nan
        self.state = DriveState.SILENT
        self.faults = DriveFault.NONE

    def take(self, status: DriveStatus, now_s: float) -> None:
        """A frame whose checksum was right."""
        if self._raw is not None:
            row = (now_s, status.node_time_s, float(status.counter), status.angle_rad)
            self._raw("drive", (*row, float(status.state), float(status.faults)))
        if self._clock.accept(status.counter, status.node_time_s, now_s):
            self.angle_rad, self.state, self.faults = status.angle_rad, status.state, status.faults

    def age_s(self, now_s: float) -> float:
        """Time since the newest status was sampled; infinite before the first."""
        return self._clock.age_s(now_s)

    def command(self, command: Command) -> None:
        """Send `command` at once or not at all: the next one comes within a tick."""
        self._counter = (self._counter + 1) % COUNTER_MODULUS
        self._heartbeat = (self._heartbeat + 1) % HEARTBEAT_MODULUS
        self._send(DRIVE_COMMAND_ID, self._codec.encode_command(command, self._counter, self._heartbeat))
