"""The base drive on the CAN bus: velocity commands out, encoder, state, supply and faults in."""

from __future__ import annotations

import math

from needle_rig.config.files import find_config_file
from needle_rig.config.schema import NodeDevice
from needle_rig.devices.device import Drive, Host
from needle_rig.devices.link_clock import LinkClock
from needle_rig.devices.shortest_way import CRYSTAL_TOLERANCE
from needle_rig.records import Command, DriveFault, Firmware
from needle_rig.wire.can_frames import (
    COUNTER_MODULUS,
    DRIVE_CALIBRATION_ID,
    DRIVE_COMMAND_ID,
    DRIVE_FIRMWARE_ID,
    DRIVE_HEALTH_ID,
    DRIVE_REFERENCE_ID,
    DRIVE_STATUS_ID,
    HEARTBEAT_MODULUS,
    DriveCommand,
    DriveHealth,
    DriveReference,
    DriveStatus,
    load_codec,
)
from needle_rig.wire.node_identity import NodeIdentity

HEALTH_AGE_LIMIT_S = 0.1
"""DRIVE_HEALTH comes every 10 ms: ten that are missing, while statuses come, mean a node that is ill."""
_IDS = (
    *(DRIVE_STATUS_ID, DRIVE_HEALTH_ID, DRIVE_COMMAND_ID, DRIVE_REFERENCE_ID),
    *(DRIVE_FIRMWARE_ID, DRIVE_CALIBRATION_ID),
)


class DriveCan(Drive):
    """Newest status of the drive with its age; every command carries the next counter and heartbeat.

    A node whose protocol is not known is neither read nor sent anything: silence alone means the same to all.
    """

    Options = NodeDevice

    def __init__(self, options: NodeDevice, host: Host) -> None:  # noqa: ARG002 a node has none
        self._host = host
        self._codec = load_codec(find_config_file("needle_rig.dbc"))
        self._bus = self.link = host.can(self._receive)
        self._clock = LinkClock(self._codec.drive_clock_period_s, CRYSTAL_TOLERANCE)
        self._counter = 0
        self._heartbeat = 0
        self._health = DriveHealth(DriveFault.NONE, False, False, False, math.nan, 0, 0)
        self._health_s = -math.inf
        self._status_faults = DriveFault.NONE
        self._identity = NodeIdentity(self._codec, "drive")

    def complaint(self, now_s: float) -> str:
        """What is wrong with a node that does speak, for a person; empty when nothing is."""
        if self._identity.refusal:
            return self._identity.refusal
        if math.isinf(self._health_s) and self._clock.age_s(now_s) < HEALTH_AGE_LIMIT_S:
            return "it sends no DRIVE_HEALTH; flash the firmware of this version: needle-rig firmware build"
        return ""

    def firmware(self, now_s: float) -> Firmware:
        """What the node says of its firmware."""
        return self._identity.told(now_s)

    def age_s(self, now_s: float) -> float:
        """Time since the newest status was sampled; infinite before the first status and the first health.

        A health that stays away counts like a status that does, once it is overdue.
        """
        if self._identity.refusal:
            return math.inf
        health_age_s = now_s - self._health_s
        age_s = self._clock.age_s(now_s)
        return max(age_s, health_age_s) if health_age_s > HEALTH_AGE_LIMIT_S else age_s

    def command(self, command: Command) -> None:
        """Send `command` at once or not at all: the next one comes within a tick."""
        if command.release or self._identity.refusal:
            return
        self._counter = (self._counter + 1) % COUNTER_MODULUS
        self._heartbeat = (self._heartbeat + 1) % HEARTBEAT_MODULUS
        self._bus.send(DRIVE_COMMAND_ID, self._codec.encode_command(command, self._counter, self._heartbeat))
        if command.reference_rad is not None:
            reference = self._codec.encode_reference(command.reference_rad, self._counter, self._heartbeat)
            self._bus.send(DRIVE_REFERENCE_ID, reference)

    def _receive(self, frame_id: int, data: bytes, now_s: float) -> None:
        content = self._codec.decode(frame_id, data) if frame_id in _IDS else None
        self._identity.take(content, now_s)
        if isinstance(content, DriveCommand | DriveReference):
            # Neither slcan nor SocketCAN gives us our own frames back: this is another master's.
            self.foreign_commands += 1
        elif self._identity.refusal:
            return
        elif isinstance(content, DriveStatus):
            self._take(content, now_s)
        elif isinstance(content, DriveHealth):
            self._take_health(content, now_s)

    def _take(self, status: DriveStatus, now_s: float) -> None:
        same = status.faults == self._status_faults  # to join flags takes as long as to decode a frame
        faults = self.faults if same else status.faults | self._health.faults
        row = (now_s, status.node_time_s, float(status.counter), status.angle_rad)
        self._host.record("drive", (*row, float(status.state), float(faults)))
        if self._clock.accept(status.counter, status.node_time_s, now_s):
            self.angle_rad, self.state, self._status_faults = status.angle_rad, status.state, status.faults
            self.faults = faults

    def _take_health(self, health: DriveHealth, now_s: float) -> None:
        """One that repeats the counter is no news."""
        if health.counter == self._health.counter and not math.isinf(self._health_s):
            return
        self._health, self._health_s = health, now_s
        self.faults = self._status_faults | health.faults
        self.referenced, self.supply_on = health.referenced, health.supply_on
        self.emergency_stop, self.index_rad = health.emergency_stop, health.index_rad
