"""CAN frames of config/needle_rig.dbc: bytes to values and back, with their checksum."""

from __future__ import annotations

import functools
import math
import os
from typing import Any, NamedTuple

import cantools
from crccheck.crc import Crc8SaeJ1850

from needle_rig.errors import BadInput
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.units import deg, nm, nmm, rad
from needle_rig.wire.layout import BYTES, Layout

TORQUE_STATUS_ID = 257
DRIVE_COMMAND_ID = 272
DRIVE_STATUS_ID = 273
DRIVE_HEALTH_ID = 274
DRIVE_REFERENCE_ID = 275
TORQUE_FIRMWARE_ID = 288
TORQUE_CALIBRATION_ID = 289
DRIVE_FIRMWARE_ID = 296
DRIVE_CALIBRATION_ID = 297
COUNTER_MODULUS = 16
HEARTBEAT_MODULUS = 65536
TORQUE_OK = 0

_FIRMWARE_SIGNALS = ("protocol", "major", "minor", "patch", "build", "counter")
_CALIBRATION_SIGNALS = ("protocol", "calibrated", "serial", "counter")

_MESSAGES = {
    TORQUE_STATUS_ID: ("TORQUE_STATUS", ("torque", "state", "counter", "node_time")),
    DRIVE_COMMAND_ID: (
        "DRIVE_COMMAND",
        ("velocity", "enable", "clear", "acknowledge", "sight", "counter", "heartbeat"),
    ),
    DRIVE_STATUS_ID: ("DRIVE_STATUS", ("angle", "state", "faults", "counter", "node_time")),
    DRIVE_HEALTH_ID: (
        "DRIVE_HEALTH",
        (
            *("motion_faults", "supply_on", "emergency_stop", "referenced", "index_seen"),
            *("index_angle", "uptime", "counter"),
        ),
    ),
    DRIVE_REFERENCE_ID: ("DRIVE_REFERENCE", ("angle", "counter", "heartbeat")),
    TORQUE_FIRMWARE_ID: ("TORQUE_FIRMWARE", _FIRMWARE_SIGNALS),
    TORQUE_CALIBRATION_ID: ("TORQUE_CALIBRATION", _CALIBRATION_SIGNALS),
    DRIVE_FIRMWARE_ID: ("DRIVE_FIRMWARE", _FIRMWARE_SIGNALS),
    DRIVE_CALIBRATION_ID: ("DRIVE_CALIBRATION", _CALIBRATION_SIGNALS),
}
"""The messages of the nodes, and their signals in the order in which they are read and written here."""
_FIRMWARE_OF = {TORQUE_FIRMWARE_ID: "torque", DRIVE_FIRMWARE_ID: "drive"}
_CALIBRATION_OF = {TORQUE_CALIBRATION_ID: "torque", DRIVE_CALIBRATION_ID: "drive"}
FIRMWARE_IDS = {node: frame_id for frame_id, node in _FIRMWARE_OF.items()}
CALIBRATION_IDS = {node: frame_id for frame_id, node in _CALIBRATION_OF.items()}
"""By node."""
_LONGEST_UPTIME_S = 65535
SIGHT_S = 0.005
"""Step of DRIVE_COMMAND.sight, in which it is rounded up."""
_OLDEST_SIGHT = 255

# crccheck works bit by bit (7 µs a frame); a table made with it costs a tenth.
_CRC8_TABLE = bytes(Crc8SaeJ1850(0).process([value]).value() for value in range(256))

# an enumeration looks a member up in a microsecond
_STATES = tuple(DriveState)
_FAULTS = tuple(DriveFault(value) for value in range(256))
_MOTION_FAULTS = tuple(DriveFault(value << 8) for value in range(256))


class TorqueStatus(NamedTuple):
    """What the torque node says; `state` 0 is good. `node_time_s` wraps at the period of its signal."""

    torque_nm: float
    state: int
    counter: int
    node_time_s: float


class DriveStatus(NamedTuple):
    """What the drive node says of its encoder and itself; `faults` is the low byte of its reasons."""

    angle_rad: float
    state: DriveState
    faults: DriveFault
    counter: int
    node_time_s: float


class DriveHealth(NamedTuple):
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


class DriveCommand(NamedTuple):
    """A command on the bus."""

    command: Command
    counter: int
    heartbeat: int


class DriveReference(NamedTuple):
    """At which angle the base stands; `heartbeat` is that of the newest command."""

    angle_rad: float
    counter: int
    heartbeat: int


class NodeFirmware(NamedTuple):
    """What `node` (torque, drive) is; `build` is 0 where nobody said."""

    node: str
    protocol: int
    version: str
    build: int
    counter: int


class NodeCalibration(NamedTuple):
    """Serial number of the page that `node` calibrates with; None where it has none."""

    node: str
    protocol: int
    serial: int | None
    counter: int


CanContent = (
    TorqueStatus | DriveStatus | DriveHealth | DriveCommand | DriveReference | NodeFirmware | NodeCalibration
)


def checksum(frame_id: int, data: bytes) -> int:
    """CRC-8 SAE J1850 over the frame id, low byte first, then data bytes 0 to 6 (rule of the DBC)."""
    table = _CRC8_TABLE
    crc = table[table[0xFF ^ frame_id & 0xFF] ^ frame_id >> 8]
    for byte in data[:7]:
        crc = table[crc ^ byte]
    return crc ^ 0xFF


class CanCodec:
    """Encodes and decodes the frames of the DBC at `path`. Raises BadInput when it is not that DBC."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        try:
            database: Any = cantools.database.load_file(os.fspath(path))
            messages = {place: database.get_message_by_name(name) for place, (name, _) in _MESSAGES.items()}
        except (OSError, KeyError, ValueError, cantools.Error) as error:
            raise BadInput(f"{os.fspath(path)}: not the DBC of a needle rig: {error}") from error
        ids = tuple(message.frame_id for message in messages.values())
        if ids != tuple(_MESSAGES):
            raise BadInput(f"{os.fspath(path)}: frame ids {ids}, but the nodes use {tuple(_MESSAGES)}")
        try:
            self._layouts = {
                place: Layout(messages[place], signals) for place, (_, signals) in _MESSAGES.items()
            }
        except ValueError as error:
            raise BadInput(f"{os.fspath(path)}: {error}") from error
        torque, drive = messages[TORQUE_STATUS_ID], messages[DRIVE_STATUS_ID]
        self.torque_clock_period_s = _period(torque, "node_time")
        self.drive_clock_period_s = _period(drive, "node_time")
        firmware = messages[TORQUE_FIRMWARE_ID].get_signal_by_name("protocol")
        self.protocols = frozenset(int(protocol) for protocol in firmware.choices or ())
        """Those that this host understands."""
        self._torque_limit_nmm = float(torque.get_signal_by_name("torque").maximum)
        self._angle_limit_deg = float(drive.get_signal_by_name("angle").maximum)
        self._velocity_limit_deg_s = float(messages[DRIVE_COMMAND_ID].get_signal_by_name("velocity").maximum)

    def encode_torque(self, torque_nm: float, state: int, counter: int, node_time_s: float) -> bytes:
        """The data of a TORQUE_STATUS frame; the torque is clipped to what the signal can carry."""
        limit = self._torque_limit_nmm
        return self._seal(
            TORQUE_STATUS_ID,
            min(max(nmm(torque_nm), -limit), limit),
            state & 15,
            counter % COUNTER_MODULUS,
            _wrapped(node_time_s, self.torque_clock_period_s, 1e-5),
        )

    def encode_drive(
        self, angle_rad: float, state: DriveState, faults: DriveFault, counter: int, node_time_s: float
    ) -> bytes:
        """The data of a DRIVE_STATUS frame; the angle is clipped to what the signal can carry.

        Of `faults` it has the low byte; the others are in DRIVE_HEALTH.
        """
        return self._seal(
            DRIVE_STATUS_ID,
            self._angle_deg(angle_rad),
            state,
            int(faults) & 0xFF,
            counter % COUNTER_MODULUS,
            _wrapped(node_time_s, self.drive_clock_period_s, 1e-4),
        )

    def encode_health(self, health: DriveHealth) -> bytes:
        """The data of a DRIVE_HEALTH frame; of its faults it has those above the low byte."""
        seen = math.isfinite(health.index_rad)
        return self._seal(
            DRIVE_HEALTH_ID,
            int(health.faults) >> 8,
            health.supply_on,
            health.emergency_stop,
            health.referenced,
            seen,
            self._angle_deg(health.index_rad) if seen else 0.0,
            min(health.uptime_s, _LONGEST_UPTIME_S),
            health.counter % COUNTER_MODULUS,
        )

    def encode_reference(self, angle_rad: float, counter: int, heartbeat: int) -> bytes:
        """The data of a DRIVE_REFERENCE frame; the angle is clipped to what the signal can carry."""
        return self._seal(
            DRIVE_REFERENCE_ID,
            self._angle_deg(angle_rad),
            counter % COUNTER_MODULUS,
            heartbeat % HEARTBEAT_MODULUS,
        )

    def encode_firmware(self, firmware: NodeFirmware) -> bytes:
        """The data of the FIRMWARE frame of `firmware.node`. Its version is three numbers."""
        major, minor, patch = map(int, firmware.version.split("."))
        return self._seal(
            FIRMWARE_IDS[firmware.node],
            firmware.protocol,
            major,
            minor,
            patch,
            firmware.build,
            firmware.counter % COUNTER_MODULUS,
        )

    def encode_calibration(self, calibration: NodeCalibration) -> bytes:
        """The data of the CALIBRATION frame of `calibration.node`."""
        return self._seal(
            CALIBRATION_IDS[calibration.node],
            calibration.protocol,
            calibration.serial is not None,
            calibration.serial or 0,
            calibration.counter % COUNTER_MODULUS,
        )

    def encode_command(self, command: Command, counter: int, heartbeat: int) -> bytes:
        """The data of a DRIVE_COMMAND frame; a velocity that is not finite becomes a stop."""
        finite = math.isfinite(command.velocity_rad_s)
        limit = self._velocity_limit_deg_s
        # an older sight cannot be told: then nothing is acknowledged
        tellable = command.acknowledge and command.sight_s <= _OLDEST_SIGHT * SIGHT_S
        return self._seal(
            DRIVE_COMMAND_ID,
            min(max(deg(command.velocity_rad_s), -limit), limit) if finite else 0.0,
            command.enable and finite,
            command.clear,
            tellable,
            math.ceil(command.sight_s / SIGHT_S - 1e-9) * SIGHT_S if tellable else 0.0,
            counter % COUNTER_MODULUS,
            heartbeat % HEARTBEAT_MODULUS,
        )

    def decode(self, frame_id: int, data: bytes) -> CanContent | None:
        """What a frame says; None when it is not of this DBC or its length or checksum is wrong."""
        layout = self._layouts.get(frame_id)
        if layout is None or len(data) != BYTES or data[7] != checksum(frame_id, data):
            return None
        values = layout.decode(data)
        if frame_id == TORQUE_STATUS_ID:
            torque_nmm, state, counter, node_time_s = values
            return TorqueStatus(nm(torque_nmm), state, counter, node_time_s)
        if frame_id == DRIVE_STATUS_ID:
            angle_deg, state, faults, counter, node_time_s = values
            return DriveStatus(rad(angle_deg), _STATES[state & 3], _FAULTS[faults], counter, node_time_s)
        if frame_id == DRIVE_HEALTH_ID:
            faults, supply, stop, referenced, seen, index_deg, uptime_s, counter = values
            return DriveHealth(
                _MOTION_FAULTS[faults],
                bool(supply),
                bool(stop),
                bool(referenced),
                rad(index_deg) if seen else math.nan,
                uptime_s,
                counter,
            )
        if frame_id == DRIVE_REFERENCE_ID:
            angle_deg, counter, heartbeat = values
            return DriveReference(rad(angle_deg), counter, heartbeat)
        if frame_id in _FIRMWARE_OF:
            protocol, major, minor, patch, build, counter = values
            version = f"{major}.{minor}.{patch}"
            return NodeFirmware(_FIRMWARE_OF[frame_id], protocol, version, build, counter)
        if frame_id in _CALIBRATION_OF:
            protocol, calibrated, serial, counter = values
            return NodeCalibration(
                _CALIBRATION_OF[frame_id], protocol, serial if calibrated else None, counter
            )
        velocity_deg_s, enable, clear, acknowledge, sight_s, counter, heartbeat = values
        command = Command(rad(velocity_deg_s), bool(enable), bool(clear), bool(acknowledge), sight_s=sight_s)
        return DriveCommand(command, counter, heartbeat)

    def _angle_deg(self, angle_rad: float) -> float:
        limit = self._angle_limit_deg
        return min(max(deg(angle_rad), -limit), limit)

    def _seal(self, frame_id: int, *values: float) -> bytes:
        data = self._layouts[frame_id].encode(*values)
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
