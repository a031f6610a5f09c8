"""CAN frames of config/needle_rig.dbc: bytes to values and back, with their checksum."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any

import cantools
from crccheck.crc import Crc8SaeJ1850

from needle_rig.errors import BadInput
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.units import deg, nm, nmm, rad

TORQUE_STATUS_ID = 257
DRIVE_COMMAND_ID = 272
DRIVE_STATUS_ID = 273
COUNTER_MODULUS = 16
HEARTBEAT_MODULUS = 65536
TORQUE_OK = 0

# crccheck works bit by bit (7 µs a frame); a table made with it costs a tenth.
_CRC8_TABLE = bytes(Crc8SaeJ1850(0).process([value]).value() for value in range(256))


@dataclass(frozen=True, slots=True)
class TorqueStatus:
    """What the torque node says; `state` 0 is good. `node_time_s` wraps at the period of its signal."""

    torque_nm: float
    state: int
    counter: int
    node_time_s: float


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """What the drive node says of its encoder and itself."""

    angle_rad: float
    state: DriveState
    faults: DriveFault
    counter: int
    node_time_s: float


@dataclass(frozen=True, slots=True)
class DriveCommand:
    """A command on the bus."""

    command: Command
    counter: int
    heartbeat: int


CanContent = TorqueStatus | DriveStatus | DriveCommand


def checksum(frame_id: int, data: bytes) -> int:
    """CRC-8 SAE J1850 over the frame id, low byte first, then data bytes 0 to 6 (rule of the DBC)."""
    crc = 0xFF
    for byte in (frame_id & 0xFF, frame_id >> 8, *data[:7]):
        crc = _CRC8_TABLE[crc ^ byte]
    return crc ^ 0xFF


class CanCodec:
    """Encodes and decodes the frames of the DBC at `path`. Raises BadInput when it is not that DBC."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        try:
            database: Any = cantools.database.load_file(os.fspath(path))
            self._torque = database.get_message_by_name("TORQUE_STATUS")
            self._command = database.get_message_by_name("DRIVE_COMMAND")
            self._drive = database.get_message_by_name("DRIVE_STATUS")
        except (OSError, KeyError, ValueError, cantools.Error) as error:
            raise BadInput(f"{os.fspath(path)}: not the DBC of a needle rig: {error}") from error
        ids = (self._torque.frame_id, self._command.frame_id, self._drive.frame_id)
        expected = (TORQUE_STATUS_ID, DRIVE_COMMAND_ID, DRIVE_STATUS_ID)
        if ids != expected:
            raise BadInput(f"{os.fspath(path)}: frame ids {ids}, but the nodes use {expected}")
        self._messages = {message.frame_id: message for message in (self._torque, self._command, self._drive)}
        self.torque_clock_period_s = _period(self._torque, "node_time")
        self.drive_clock_period_s = _period(self._drive, "node_time")
        self._torque_limit_nmm = float(self._torque.get_signal_by_name("torque").maximum)
        self._angle_limit_deg = float(self._drive.get_signal_by_name("angle").maximum)
        self._velocity_limit_deg_s = float(self._command.get_signal_by_name("velocity").maximum)

    def encode_torque(self, torque_nm: float, state: int, counter: int, node_time_s: float) -> bytes:
        """The data of a TORQUE_STATUS frame; the torque is clipped to what the signal can carry."""
        limit = self._torque_limit_nmm
        return self._seal(
            self._torque,
            torque=min(max(nmm(torque_nm), -limit), limit),
            state=state & 15,
            counter=counter % COUNTER_MODULUS,
            node_time=_wrapped(node_time_s, self.torque_clock_period_s, 1e-5),
        )

    def encode_drive(
        self, angle_rad: float, state: DriveState, faults: DriveFault, counter: int, node_time_s: float
    ) -> bytes:
        """The data of a DRIVE_STATUS frame; the angle is clipped to what the signal can carry."""
        limit = self._angle_limit_deg
        return self._seal(
            self._drive,
            angle=min(max(deg(angle_rad), -limit), limit),
            state=int(state),
            faults=int(faults),
            counter=counter % COUNTER_MODULUS,
            node_time=_wrapped(node_time_s, self.drive_clock_period_s, 1e-4),
        )

    def encode_command(self, command: Command, counter: int, heartbeat: int) -> bytes:
        """The data of a DRIVE_COMMAND frame; a velocity that is not finite becomes a stop."""
        finite = math.isfinite(command.velocity_rad_s)
        limit = self._velocity_limit_deg_s
        return self._seal(
            self._command,
            velocity=min(max(deg(command.velocity_rad_s), -limit), limit) if finite else 0.0,
            enable=int(command.enable and finite),
            clear=int(command.clear),
            counter=counter % COUNTER_MODULUS,
            heartbeat=heartbeat % HEARTBEAT_MODULUS,
        )

    def decode(self, frame_id: int, data: bytes) -> CanContent | None:
        """What a frame says; None when it is not of this DBC or its length or checksum is wrong."""
        message = self._messages.get(frame_id)
        if message is None or len(data) != 8 or data[7] != checksum(frame_id, data):
            return None
        values = message.decode(data, decode_choices=False)
        if frame_id == TORQUE_STATUS_ID:
            return TorqueStatus(nm(values["torque"]), values["state"], values["counter"], values["node_time"])
        if frame_id == DRIVE_STATUS_ID:
            return DriveStatus(
                rad(values["angle"]),
                DriveState(values["state"] & 3),
                DriveFault(values["faults"]),
                values["counter"],
                values["node_time"],
            )
        command = Command(rad(values["velocity"]), bool(values["enable"]), bool(values["clear"]))
        return DriveCommand(command, values["counter"], values["heartbeat"])

    def _seal(self, message: Any, **values: float) -> bytes:
        # Not strict: the values are within their signals already, and checking costs as much as encoding.
        data: bytes = message.encode({**values, "checksum": 0}, strict=False)
        return data[:7] + bytes((checksum(message.frame_id, data),))


def _period(message: Any, name: str) -> float:
    """After how many seconds the clock signal `name` starts again at zero."""
    signal = message.get_signal_by_name(name)
    return float(2**signal.length * signal.scale)


def _wrapped(time_s: float, period_s: float, step_s: float) -> float:
    """`time_s` on a clock that wraps, kept below the period after rounding to its step."""
    return float(round(time_s / step_s) % round(period_s / step_s)) * step_s
