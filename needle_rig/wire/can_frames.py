"""CAN frames of config/needle_rig.dbc: bytes to values and back, with their checksum."""

from __future__ import annotations

import functools
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
DRIVE_HEALTH_ID = 274
DRIVE_REFERENCE_ID = 275
COUNTER_MODULUS = 16
HEARTBEAT_MODULUS = 65536
TORQUE_OK = 0

_NAMES = {
    TORQUE_STATUS_ID: "TORQUE_STATUS",
    DRIVE_COMMAND_ID: "DRIVE_COMMAND",
    DRIVE_STATUS_ID: "DRIVE_STATUS",
    DRIVE_HEALTH_ID: "DRIVE_HEALTH",
    DRIVE_REFERENCE_ID: "DRIVE_REFERENCE",
}
_LONGEST_UPTIME_S = 65535
SIGHT_S = 0.005
"""Step of DRIVE_COMMAND.sight, in which it is rounded up."""
_OLDEST_SIGHT = 255

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
    """What the drive node says of its encoder and itself; `faults` is the low byte of its reasons."""

    angle_rad: float
    state: DriveState
    faults: DriveFault
    counter: int
    node_time_s: float


@dataclass(frozen=True, slots=True)
class DriveHealth:
    """What the drive node says of its supply and its zero; `faults` are its reasons above the low byte.

    `index_rad` is NaN until the index mark passed; `uptime_s` stops at the end of its range.
    """

    faults: DriveFault
    supply_on: bool
    emergency_stop: bool
    referenced: bool
    index_rad: float
    uptime_s: int
    counter: int


@dataclass(frozen=True, slots=True)
class DriveCommand:
    """A command on the bus."""

    command: Command
    counter: int
    heartbeat: int


@dataclass(frozen=True, slots=True)
class DriveReference:
    """At which angle the base stands; `heartbeat` is that of the newest command."""

    angle_rad: float
    counter: int
    heartbeat: int


CanContent = TorqueStatus | DriveStatus | DriveHealth | DriveCommand | DriveReference


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
            self._messages = {place: database.get_message_by_name(name) for place, name in _NAMES.items()}
        except (OSError, KeyError, ValueError, cantools.Error) as error:
            raise BadInput(f"{os.fspath(path)}: not the DBC of a needle rig: {error}") from error
        ids = tuple(message.frame_id for message in self._messages.values())
        if ids != tuple(_NAMES):
            raise BadInput(f"{os.fspath(path)}: frame ids {ids}, but the nodes use {tuple(_NAMES)}")
        torque, drive = self._messages[TORQUE_STATUS_ID], self._messages[DRIVE_STATUS_ID]
        self.torque_clock_period_s = _period(torque, "node_time")
        self.drive_clock_period_s = _period(drive, "node_time")
        self._torque_limit_nmm = float(torque.get_signal_by_name("torque").maximum)
        self._angle_limit_deg = float(drive.get_signal_by_name("angle").maximum)
        self._velocity_limit_deg_s = float(
            self._messages[DRIVE_COMMAND_ID].get_signal_by_name("velocity").maximum
        )

    def encode_torque(self, torque_nm: float, state: int, counter: int, node_time_s: float) -> bytes:
        """The data of a TORQUE_STATUS frame; the torque is clipped to what the signal can carry."""
        limit = self._torque_limit_nmm
        return self._seal(
            TORQUE_STATUS_ID,
            torque=min(max(nmm(torque_nm), -limit), limit),
            state=state & 15,
            counter=counter % COUNTER_MODULUS,
            node_time=_wrapped(node_time_s, self.torque_clock_period_s, 1e-5),
        )

    def encode_drive(
        self, angle_rad: float, state: DriveState, faults: DriveFault, counter: int, node_time_s: float
    ) -> bytes:
        """The data of a DRIVE_STATUS frame; the angle is clipped to what the signal can carry.

        Of `faults` it has the low byte; the others are in DRIVE_HEALTH.
        """
        return self._seal(
            DRIVE_STATUS_ID,
            angle=self._angle_deg(angle_rad),
            state=int(state),
            faults=int(faults) & 0xFF,
            counter=counter % COUNTER_MODULUS,
            node_time=_wrapped(node_time_s, self.drive_clock_period_s, 1e-4),
        )

    def encode_health(self, health: DriveHealth) -> bytes:
        """The data of a DRIVE_HEALTH frame; of its faults it has those above the low byte."""
        seen = math.isfinite(health.index_rad)
        return self._seal(
            DRIVE_HEALTH_ID,
            motion_faults=int(health.faults) >> 8,
            supply_on=int(health.supply_on),
            emergency_stop=int(health.emergency_stop),
            referenced=int(health.referenced),
            index_seen=int(seen),
            counter=health.counter % COUNTER_MODULUS,
            index_angle=self._angle_deg(health.index_rad) if seen else 0.0,
            uptime=min(health.uptime_s, _LONGEST_UPTIME_S),
        )

    def encode_reference(self, angle_rad: float, counter: int, heartbeat: int) -> bytes:
        """The data of a DRIVE_REFERENCE frame; the angle is clipped to what the signal can carry."""
        return self._seal(
            DRIVE_REFERENCE_ID,
            angle=self._angle_deg(angle_rad),
            counter=counter % COUNTER_MODULUS,
            heartbeat=heartbeat % HEARTBEAT_MODULUS,
        )

    def encode_command(self, command: Command, counter: int, heartbeat: int) -> bytes:
        """The data of a DRIVE_COMMAND frame; a velocity that is not finite becomes a stop."""
        finite = math.isfinite(command.velocity_rad_s)
        limit = self._velocity_limit_deg_s
        # an older sight cannot be told: then nothing is acknowledged
        tellable = command.acknowledge and command.sight_s <= _OLDEST_SIGHT * SIGHT_S
        return self._seal(
            DRIVE_COMMAND_ID,
            velocity=min(max(deg(command.velocity_rad_s), -limit), limit) if finite else 0.0,
            enable=int(command.enable and finite),
            clear=int(command.clear),
            acknowledge=int(tellable),
            sight=math.ceil(command.sight_s / SIGHT_S - 1e-9) * SIGHT_S if tellable else 0.0,
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
        if frame_id == DRIVE_HEALTH_ID:
            return DriveHealth(
                DriveFault(values["motion_faults"] << 8),
                bool(values["supply_on"]),
                bool(values["emergency_stop"]),
                bool(values["referenced"]),
                rad(values["index_angle"]) if values["index_seen"] else math.nan,
                values["uptime"],
                values["counter"],
            )
        if frame_id == DRIVE_REFERENCE_ID:
            return DriveReference(rad(values["angle"]), values["counter"], values["heartbeat"])
        enable, clear, acknowledge = (bool(values[name]) for name in ("enable", "clear", "acknowledge"))
        command = Command(rad(values["velocity"]), enable, clear, acknowledge, sight_s=values["sight"])
        return DriveCommand(command, values["counter"], values["heartbeat"])

    def _angle_deg(self, angle_rad: float) -> float:
        limit = self._angle_limit_deg
        return min(max(deg(angle_rad), -limit), limit)

    def _seal(self, frame_id: int, **values: float) -> bytes:
        # Not strict: the values are within their signals already, and checking costs as much as encoding.
        data: bytes = self._messages[frame_id].encode({**values, "checksum": 0}, strict=False)
        return data[:7] + bytes((checksum(frame_id, data),))


@functools.cache
def load_codec(path: str | os.PathLike[str]) -> CanCodec:
    """The codec of the DBC at `path`, made once. Raises BadInput when it is not that DBC."""
    return CanCodec(path)


def _period(message: Any, name: str) -> float:
    """After how many seconds the clock signal `name` starts again at zero."""
    signal = message.get_signal_by_name(name)
    return float(2**signal.length * signal.scale)


def _wrapped(time_s: float, period_s: float, step_s: float) -> float:
    """`time_s` on a clock that wraps, kept below the period after rounding to its step."""
    return float(round(time_s / step_s) % round(period_s / step_s)) * step_s
