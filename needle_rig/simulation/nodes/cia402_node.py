"""A CiA 402 drive as its standard describes it: CANopen frames in and out, its own clock in µs.

Of CiA 301 (NMT, SDO, PDO, SYNC, EMCY, heartbeat) and CiA 402-2 (state machine, velocity modes).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from needle_rig.config.schema import Cia402Drive
from needle_rig.records import DriveFault, DriveState
from needle_rig.simulation.nodes.front_end import ENCODER_COUNTS_PER_DEG
from needle_rig.simulation.nodes.slcan_hub import Frame

PRE_OPERATIONAL, OPERATIONAL, STOPPED = 0x7F, 0x05, 0x04

_NOT_THERE, _READ_ONLY, _WRONG_LENGTH = 0x06020000, 0x06010002, 0x06070010
_NO_SUBINDEX, _OUT_OF_RANGE, _NOT_NOW = 0x06090011, 0x06090030, 0x08000022
_SDO_COMMAND = 0x05040001
_NO_HEARTBEAT = 0x8130
_QUICK_STOP_RAD_S2 = math.radians(2000.0)
_SUPPORTED_MODES = 1 << 2 | 1 << 8
_PV, _CSV = 3, 9

_STATUS_BITS = {
    "switch on disabled": 0x0040,
    "ready to switch on": 0x0021,
    "switched on": 0x0023,
    "operation enabled": 0x0027,
    "quick stop active": 0x0007,
    "fault reaction active": 0x000F,
    "fault": 0x0008,
}
_DRIVE_STATES = {
    "switch on disabled": DriveState.SILENT,
    "ready to switch on": DriveState.READY,
    "switched on": DriveState.READY,
    "operation enabled": DriveState.RUNNING,
    "quick stop active": DriveState.FAULT,
    "fault reaction active": DriveState.FAULT,
    "fault": DriveState.FAULT,
}


@dataclass
class _Entry:
    """One object: how many bytes it has, its value, whether it may be written."""

    size_bytes: int
    value: int = 0
    writable: bool = True


class Cia402Node:
    """A drive with its motor's encoder; `options` are the units that its maker's tool was set to."""

    def __init__(self, options: Cia402Drive) -> None:
        self._id = options.node_id
        way = -1.0 if options.reversed else 1.0
        self._units_per_deg = way * options.position_units_per_turn / 360.0
        self._rad_s_per_unit = way * math.tau / 60.0 / options.velocity_units_per_rpm
        self.reset(0)

    def reset(self, now_us: int) -> None:
        """The drive starts: its counts begin at zero, its settings are the factory's."""
        self._now_us = self._step_us = now_us
        self._objects = _factory_settings(self._id)
        self._network = PRE_OPERATIONAL
        self._outbox: list[Frame] = [(0x700 + self._id, b"\x00")]
        self._state = "switch on disabled"
        self._controlword = 0
        self._waiting_rpdo: bytes | None = None
        self._syncs = 0
        self._host_us: int | None = None
        self._host_lost = False
        self._zero_counts: int | None = None
        self._velocity_rad_s = 0.0
        self._stopped_by = DriveFault.NONE
        self._emergency_stop = False

    @property
    def state(self) -> DriveState:
        """Its state in the words of a drive node; a quick stop is a stop by itself."""
        return DriveState.FAULT if self._host_lost else _DRIVE_STATES[self._state]

    @property
    def faults(self) -> DriveFault:
        """Why it stopped by itself."""
        return self._stopped_by

    @property
    def powered(self) -> bool:
        """Whether the motor is on."""
        return self._state in ("operation enabled", "quick stop active", "fault reaction active")

    @property
    def supply_on(self) -> bool:
        """Whether its power stage has its supply."""
        return not self._emergency_stop

    def receive(self, now_us: int, frame_id: int, data: bytes) -> None:
        """A frame seen on the bus; answers go out with the next step."""
        self._now_us = now_us
        if frame_id == 0x000 and len(data) == 2 and data[1] in (0, self._id):
            self._manage(data[0])
        elif frame_id == 0x080:
            self._sync()
        elif frame_id == 0x600 + self._id and len(data) == 8 and self._network != STOPPED:
            self._outbox.append((0x580 + self._id, self._serve(data)))
        elif frame_id == self._pdo(0x1400) and self._network == OPERATIONAL:
            self._waiting_rpdo = data
            if self._objects[0x1400, 2].value >= 254:
                self._take_rpdo()
        elif frame_id == 0x700 + (self._objects[0x1016, 1].value >> 16 & 0x7F) and len(data) == 1:
            self._host_us = now_us
            if self._host_lost:
                self._host_lost = False
                self._emergency(0)

    def step(
        self, now_us: int, encoder_counts: int, *, index: bool = False, emergency_stop: bool = False
    ) -> tuple[tuple[Frame, ...], float]:
        """The frames of one sample, and the velocity in rad/s asked of the motor."""
        del index  # this drive has no such input
        self._now_us = now_us
        elapsed_s, self._step_us = (now_us - self._step_us) * 1e-6, now_us
        if self._zero_counts is None:
            self._zero_counts = encoder_counts
        turned_deg = (encoder_counts - self._zero_counts) / ENCODER_COUNTS_PER_DEG
        self._objects[0x6064, 0].value = round(turned_deg * self._units_per_deg) % 2**32
        self._emergency_stop = emergency_stop
        self._watch_host()
        self._run_state_machine()
        self._turn(elapsed_s)
        frames, self._outbox = tuple(self._outbox), []
        return frames, self._velocity_rad_s

    def fail(self, error_code: int) -> None:
        """Something in the drive breaks: it says so, brakes, and stands in fault."""
        self._objects[0x603F, 0].value = error_code
        self._emergency(error_code)
        self._state = "fault reaction active" if self.powered else "fault"

    def _manage(self, command: int) -> None:
        if command in (0x81, 0x82):
            self.reset(self._now_us)
        elif command in (0x01, 0x02, 0x80):
            self._network = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PRE_OPERATIONAL}[command]

    def _pdo(self, settings: int) -> int | None:
        """The frame id of a PDO; None while it is off."""
        value = self._objects[settings, 1].value
        return None if value & 0x80000000 else value & 0x7FF

    def _sync(self) -> None:
        if self._network != OPERATIONAL:
            return
        self._syncs += 1
        if self._objects[0x1400, 2].value <= 240:
            self._take_rpdo()
        every, frame_id = self._objects[0x1800, 2].value, self._pdo(0x1800)
        if frame_id is None or not 1 <= every <= 240 or self._syncs % every:
            return
        data = b""
        for entry in self._mapped(0x1A00):
            data += entry.value.to_bytes(entry.size_bytes, "little")
        self._outbox.append((frame_id, data))

    def _mapped(self, mapping: int) -> list[_Entry]:
        found = []
        for place in range(1, self._objects[mapping, 0].value + 1):
            entry = self._objects[mapping, place].value
            found.append(self._objects[entry >> 16, entry >> 8 & 0xFF])
        return found

    def _take_rpdo(self) -> None:
        data, self._waiting_rpdo = self._waiting_rpdo, None
        entries = self._mapped(0x1600)
        if data is None or len(data) < sum(entry.size_bytes for entry in entries):
            return
        for entry in entries:
            entry.value = int.from_bytes(data[: entry.size_bytes], "little")
            data = data[entry.size_bytes :]

    def _serve(self, request: bytes) -> bytes:
        """The answer to an expedited SDO request."""
        command, index, subindex = struct.unpack_from("<BHB", request)
        entry = self._objects.get((index, subindex))
        refused = 0
        if entry is None:
            refused = _NO_SUBINDEX if any(known == index for known, _ in self._objects) else _NOT_THERE
        elif command >> 5 == 2:
            told = entry.value.to_bytes(4, "little")
            return struct.pack("<BHB4s", 0x43 | (4 - entry.size_bytes) << 2, index, subindex, told)
        elif command >> 5 != 1 or not command & 2:
            refused = _SDO_COMMAND
        else:
            size = 4 - (command >> 2 & 3) if command & 1 else entry.size_bytes
            refused = self._set(index, subindex, entry, size, int.from_bytes(request[4 : 4 + size], "little"))
            if not refused:
                return struct.pack("<BHB4x", 0x60, index, subindex)
        return struct.pack("<BHBI", 0x80, index, subindex, refused)

    def _set(self, index: int, subindex: int, entry: _Entry, size_bytes: int, value: int) -> int:
        """Write an object; 0, or why not."""
        if not entry.writable:
            return _READ_ONLY
        if size_bytes != entry.size_bytes:
            return _WRONG_LENGTH
        if index in (0x1600, 0x1A00):
            if self._pdo(index - 0x200) is not None:
                return _NOT_NOW
            if subindex == 0 and value > 4:
                return _OUT_OF_RANGE
            if subindex and (value >> 16, value >> 8 & 0xFF) not in self._objects:
                return _NOT_THERE
        if index == 0x6060 and value not in (_PV, _CSV):
            return _OUT_OF_RANGE
        entry.value = value
        if index == 0x6060:
            self._objects[0x6061, 0].value = value
        if index == 0x1016:
            self._host_us, self._host_lost = None, False
        return 0

    def _watch_host(self) -> None:
        """The heartbeat consumer: it watches from the first heartbeat on."""
        limit_us = (self._objects[0x1016, 1].value & 0xFFFF) * 1000
        if (
            not limit_us
            or self._host_us is None
            or self._host_lost
            or self._now_us - self._host_us <= limit_us
        ):
            return
        self._host_lost = True
        self._stopped_by = DriveFault.HEARTBEAT
        self._objects[0x603F, 0].value = _NO_HEARTBEAT
        self._emergency(_NO_HEARTBEAT)
        if self._objects[0x1029, 1].value == 0 and self._network == OPERATIONAL:
            self._network = PRE_OPERATIONAL
        action = self._objects[0x6007, 0].value
        if action == 1:
            self._state = "fault reaction active" if self.powered else "fault"
        elif action == 2 or (action == 3 and self._state in ("ready to switch on", "switched on")):
            self._state = "switch on disabled"
        elif action == 3 and self._state == "operation enabled":
            self._state = "quick stop active"
        if action:
            self._objects[0x6040, 0].value = 0  # what was asked for before does not wake it

    def _run_state_machine(self) -> None:
        word, before = self._objects[0x6040, 0].value, self._controlword
        self._controlword = word
        at_rest = self._velocity_rad_s == 0.0
        if self._state == "fault reaction active":
            self._state = "fault" if at_rest else self._state
        elif self._state == "fault":
            if word & 0x80 and not before & 0x80:
                self._state, self._stopped_by = "switch on disabled", DriveFault.NONE
                self._objects[0x603F, 0].value = 0
                self._emergency(0)
        elif self._state == "quick stop active":
            if at_rest or not word & 0x02:
                self._state = "switch on disabled"
        elif self._emergency_stop or not word & 0x02:
            self._state = "switch on disabled"
        elif not word & 0x04:
            self._state = "quick stop active" if self._state == "operation enabled" else "switch on disabled"
        elif not word & 0x01:
            self._state = "ready to switch on"
        elif self._state == "ready to switch on":
            self._state = "switched on"
        elif self._state in ("switched on", "operation enabled"):
            self._state = "operation enabled" if word & 0x08 else "switched on"
        if self._state in ("ready to switch on", "switched on", "operation enabled"):
            self._stopped_by = DriveFault.NONE

    def _turn(self, elapsed_s: float) -> None:
        """CSV follows at once, PV by its profile's ramp; a stop brakes by the quick stop's."""
        if self._state == "operation enabled" and self._objects[0x6060, 0].value in (_PV, _CSV):
            wanted_rad_s = _signed(self._objects[0x60FF, 0].value) * self._rad_s_per_unit
            ramp = self._objects[0x6083, 0].value * abs(self._rad_s_per_unit)
            most = math.inf if self._objects[0x6060, 0].value == _CSV else ramp * elapsed_s
        elif self.powered:
            wanted_rad_s, most = 0.0, _QUICK_STOP_RAD_S2 * elapsed_s
        else:
            wanted_rad_s, most = 0.0, math.inf
        change = wanted_rad_s - self._velocity_rad_s
        self._velocity_rad_s += min(max(change, -most), most)
        self._objects[0x606C, 0].value = round(self._velocity_rad_s / self._rad_s_per_unit) % 2**32
        status = _STATUS_BITS[self._state] | (0x0200 if self._network == OPERATIONAL else 0)
        self._objects[0x6041, 0].value = status | (0 if self._emergency_stop else 0x0010)

    def _emergency(self, code: int) -> None:
        register = 0 if code == 0 else 0x11 if code >> 8 == 0x81 else 0x01
        self._outbox.append((0x080 + self._id, struct.pack("<HB5x", code, register)))


def _factory_settings(node_id: int) -> dict[tuple[int, int], _Entry]:
    made: dict[tuple[int, int], _Entry] = {
        (0x1000, 0): _Entry(4, 0x00020192, writable=False),
        (0x1001, 0): _Entry(1, 0, writable=False),
        (0x1016, 0): _Entry(1, 1, writable=False),
        (0x1016, 1): _Entry(4),
        (0x1017, 0): _Entry(2),
        (0x1029, 1): _Entry(1),
        (0x1400, 1): _Entry(4, 0x200 + node_id),
        (0x1400, 2): _Entry(1, 255),
        (0x1800, 1): _Entry(4, 0x40000180 + node_id),
        (0x1800, 2): _Entry(1, 255),
        (0x603F, 0): _Entry(2, 0, writable=False),
        (0x6040, 0): _Entry(2),
        (0x6041, 0): _Entry(2, 0x0040, writable=False),
        (0x6007, 0): _Entry(2, 1),
        (0x605A, 0): _Entry(2, 2),
        (0x6060, 0): _Entry(1),
        (0x6061, 0): _Entry(1, 0, writable=False),
        (0x6064, 0): _Entry(4, 0, writable=False),
        (0x606C, 0): _Entry(4, 0, writable=False),
        (0x6083, 0): _Entry(4, 1_000_000),
        (0x60C2, 1): _Entry(1, 1),
        (0x60C2, 2): _Entry(1, 0xFD),
        (0x60FF, 0): _Entry(4),
        (0x6502, 0): _Entry(4, _SUPPORTED_MODES, writable=False),
    }
    for mapping, objects in ((0x1600, (0x60400010,)), (0x1A00, (0x60410010,))):
        made[mapping, 0] = _Entry(1, len(objects))
        for place in range(1, 5):
            made[mapping, place] = _Entry(4, objects[place - 1] if place <= len(objects) else 0)
    return made


def _signed(value: int) -> int:
    return value - 2**32 if value >= 2**31 else value
