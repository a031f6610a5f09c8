"""The base drive on the CAN bus: velocity commands out, encoder, state, supply and faults in."""

from __future__ import annotations

import math
from collections.abc import Callable

from needle_rig.devices.link_clock import LinkClock
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.rig import RawReadings
from needle_rig.wire.can_frames import (
    COUNTER_MODULUS,
    DRIVE_COMMAND_ID,
    DRIVE_REFERENCE_ID,
    HEARTBEAT_MODULUS,
    CanCodec,
    DriveHealth,
    DriveStatus,
)

HEALTH_AGE_LIMIT_S = 0.1
"""DRIVE_HEALTH comes every 10 ms: ten that are missing, while statuses come, mean a node that is ill."""


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
        self._status_faults = DriveFault.NONE
        self._health = DriveHealth(DriveFault.NONE, False, False, False, math.nan, 0, 0)
        self._health_s = -math.inf
        self.angle_rad = math.nan
        self.state = DriveState.SILENT

    @property
    def faults(self) -> DriveFault:
        """Every reason that the drive gives."""
        return self._status_faults | self._health.faults

    @property
    def referenced(self) -> bool:
        """Whether the node knows its zero; False after it started."""
        return self._health.referenced

    @property
    def supply_on(self) -> bool:
        """Whether the safe-torque-off line lets the motor have its supply."""
        return self._health.supply_on

    @property
    def emergency_stop(self) -> bool:
        """Whether the emergency stop is pressed or its loop broken."""
        return self._health.emergency_stop

    @property
    def index_rad(self) -> float:
        """Angle at which the index mark passed last; NaN until it did."""
        return self._health.index_rad

    def take(self, status: DriveStatus, now_s: float) -> None:
        """A DRIVE_STATUS whose checksum was right."""
        if self._raw is not None:
            row = (now_s, status.node_time_s, float(status.counter), status.angle_rad)
            self._raw("drive", (*row, float(status.state), float(status.faults | self._health.faults)))
        if self._clock.accept(status.counter, status.node_time_s, now_s):
            self.angle_rad, self.state, self._status_faults = status.angle_rad, status.state, status.faults

    def take_health(self, health: DriveHealth, now_s: float) -> None:
        """A DRIVE_HEALTH whose checksum was right; one that repeats the counter is no news."""
        if health.counter != self._health.counter or math.isinf(self._health_s):
            self._health, self._health_s = health, now_s

    def age_s(self, now_s: float) -> float:
        """Time since the newest status was sampled; infinite before the first status and the first health.

        A health that stays away counts like a status that does, once it is overdue.
        """
        health_age_s = now_s - self._health_s
        age_s = self._clock.age_s(now_s)
        return max(age_s, health_age_s) if health_age_s > HEALTH_AGE_LIMIT_S else age_s

    def complaint(self, now_s: float) -> str:
        """What is wrong with a node that does speak, for the message of a missing link."""
        if math.isinf(self._health_s) and self._clock.age_s(now_s) < HEALTH_AGE_LIMIT_S:
            return "it sends no DRIVE_HEALTH; flash the firmware of this version: needle-rig firmware build"
        return ""

    def command(self, command: Command) -> None:
        """Send `command` at once or not at all: the next one comes within a tick."""
        if command.release:
            return
        self._counter = (self._counter + 1) % COUNTER_MODULUS
        self._heartbeat = (self._heartbeat + 1) % HEARTBEAT_MODULUS
        self._send(DRIVE_COMMAND_ID, self._codec.encode_command(command, self._counter, self._heartbeat))
        if command.reference_rad is not None:
            reference = self._codec.encode_reference(command.reference_rad, self._counter, self._heartbeat)
            self._send(DRIVE_REFERENCE_ID, reference)
