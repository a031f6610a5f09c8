"""A drive that speaks CiA 402 over CANopen: cyclic synchronous velocity or profile velocity.

Every tick sends the controlword with the target velocity, this computer's heartbeat, and a SYNC, which the
drive answers with statusword, position and error code. The heartbeat comes from the tick and from nothing
else, so that a host that hangs falls silent, and the drive's own heartbeat consumer stops it.

Of CiA 301 (SDO, PDO, SYNC, EMCY, heartbeat) and CiA 402-2 (state machine, modes, 0x6007).
"""

from __future__ import annotations

import asyncio
import math
import struct
from collections import deque

from needle_rig.config.schema import Cia402Drive
from needle_rig.control.reference import FASTEST_RAD_S, JUMP_RAD
from needle_rig.devices.canopen_node import CanopenNode, OperationMode, State402, decode_emergency, meaning_of
from needle_rig.devices.device import SILENT_S, Drive, Host
from needle_rig.errors import RigFault
from needle_rig.records import RELEASE, TEMPORARY, Command, DriveFault, DriveState, Firmware

PROFILE, NO_HEARTBEAT = 402, 0x8130
QUICK_STOP, STOP_AND_DISABLE, KEEP_STATE = 3, 2, 1
"""Options of 0x6007, 0x605A, 0x1029: brake, then take the power off, and stay on the bus."""

_SYNC_ID, _NMT_ID = 0x080, 0x000
_OPERATIONAL = b"\x05"
_INT32 = 2**31 - 1
_COMMAND = struct.Struct("<Hi")
_STATUS = struct.Struct("<HiH")
_VOLTAGE_ENABLED = 0x10
_MODES = {  # code in 0x6060, bit in 0x6502
    "csv": (OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY, 1 << 8),
    "pv": (OperationMode.PROFILED_VELOCITY, 1 << 2),
}
_STATES = {
    "NOT READY TO SWITCH ON": DriveState.SILENT,
    "SWITCH ON DISABLED": DriveState.SILENT,
    "QUICK STOP ACTIVE": DriveState.SILENT,
    "READY TO SWITCH ON": DriveState.READY,
    "SWITCHED ON": DriveState.READY,
    "OPERATION ENABLED": DriveState.RUNNING,
    "FAULT REACTION ACTIVE": DriveState.FAULT,
    "FAULT": DriveState.FAULT,
}
_AWAKE = (DriveState.READY, DriveState.RUNNING)
_UPWARDS = {
    "SWITCH ON DISABLED": State402.CW_SHUTDOWN,
    "READY TO SWITCH ON": State402.CW_SWITCH_ON,
    "SWITCHED ON": State402.CW_OPERATION_ENABLED,
    "OPERATION ENABLED": State402.CW_OPERATION_ENABLED,
}
_LATE_S, _QUIET_S, _LOST_S, _ROUNDING_S = 0.02, 0.012, 0.05, 1e-6
_TICKS_OPEN = 1.5


class DriveCia402(Drive):
    """A position is as old as the SYNC that it answers.

    The drive's frames carry neither counter nor clock: one that repeats its last status at every SYNC looks
    like a drive at rest, and shows as a drive that does not follow.
    """

    Options = Cia402Drive

    def __init__(self, options: Cia402Drive, host: Host) -> None:
        self._options, self._host = options, host
        self._bus = self.link = host.can(self._receive)
        self._node = CanopenNode(options.node_id, self._bus)
        self._status_id, self._command_id = 0x180 + options.node_id, 0x200 + options.node_id
        self._emergency_id, self._boot_id = 0x080 + options.node_id, 0x700 + options.node_id
        self._host_id = 127 if options.node_id != 127 else 126
        self._heartbeat_id = 0x700 + self._host_id
        self._masters = {_NMT_ID, _SYNC_ID, self._command_id, 0x600 + options.node_id, self._heartbeat_id}
        way = -1.0 if options.reversed else 1.0
        self._unit_rad = way * math.tau / options.position_units_per_turn
        self._units_per_rad_s = way * options.velocity_units_per_rpm * 60.0 / math.tau
        self._answers = SyncAnswers(self._host.tick_s)
        self._set_up = False
        self._set_up_s = -math.inf
        self._woken = False
        self._state = "NOT READY TO SWITCH ON"
        self._units: int | None = None
        self._zero_rad = 0.0
        self._sampled_s = self._taken_s = -math.inf
        self._emergency: tuple[int, str] | None = None
        self._passed = False
        self._error_code = 0
        self._supply_cut = False
        """It lost its supply while it was awake: an emergency stop of a rig opens it."""
        self._counter = 0
        self._starts = 0
        self._firmware = Firmware()

    def age_s(self, now_s: float) -> float:
        """Time since the SYNC that the newest status answers; infinite before the first."""
        return now_s - self._sampled_s

    def complaint(self, now_s: float) -> str:  # noqa: ARG002
        """The drive's emergency, or its error code while it stands in fault."""
        if self._emergency is not None:
            return self._emergency[1]
        if self.state is DriveState.FAULT and self._error_code:
            return f"error 0x{self._error_code:04x} ({meaning_of(self._error_code)})"
        return ""

    def firmware(self, now_s: float) -> Firmware:  # noqa: ARG002 it was asked when it was set up
        """The profile that it speaks, and its software's version where it has told one."""
        return self._firmware

    def needs_set_up(self, now_s: float) -> bool:
        """A drive that started again has lost its settings, its zero, and its stop for a lost host."""
        return not self._set_up or now_s - max(self._taken_s, self._set_up_s) > SILENT_S

    async def set_up(self) -> None:
        """Take the power off, write the drive's settings, read back those that stop it, and start its PDOs.

        Raises RigFault when it does not take one of them: then it could not be trusted to stop by itself.
        """
        self._set_up = self._woken = False
        starts = self._starts
        await asyncio.to_thread(self._configure)
        if self._starts != starts:
            raise RigFault(f"CANopen node {self._options.node_id} started again while it was set up")
        self._units, self._zero_rad, self.referenced = None, 0.0, False
        self._emergency, self._error_code, self.faults = None, 0, DriveFault.NONE
        self._answers = SyncAnswers(self._host.tick_s)
        self._set_up, self._set_up_s = True, self._host.now()

    def shut_down(self) -> None:
        """Take the power off."""
        self.command(RELEASE)

    def command(self, command: Command) -> None:
        """Send controlword and velocity, heartbeat and SYNC."""
        now_s = self._host.now()
        if command.reference_rad is not None and self._set_up and self.state is not DriveState.RUNNING:
            self._zero_rad += self.angle_rad - command.reference_rad
            self.angle_rad, self.referenced = command.reference_rad, True
        velocity = command.velocity_rad_s * self._units_per_rad_s if command.enable else 0.0
        target = round(min(max(velocity, -_INT32), _INT32)) if math.isfinite(velocity) else 0
        self._bus.send(self._command_id, _COMMAND.pack(self._controlword(command), target))
        if not (command.release and self.state is DriveState.RUNNING):  # its own guard ends what others ask
            self._bus.send(self._heartbeat_id, _OPERATIONAL)
        if self._answers.ask(now_s):
            self._bus.send(_SYNC_ID, b"")

    def _controlword(self, command: Command) -> int:
        """The next step of the state machine towards what is asked.

        A drive is woken by a clear alone: one that lost its power by itself keeps it off until then. A fault
        that latches is reset by a clear that a person acknowledged, and so is a supply that was cut.
        """
        in_fault = self._state == "FAULT"
        latched = self._supply_cut or (in_fault and (not self.faults or bool(self.faults & ~TEMPORARY)))
        clears = command.clear and (command.acknowledge or not latched)
        if command.release or not self._set_up:
            self._woken = False
        elif clears and in_fault:
            self._supply_cut = False
            return State402.CW_SWITCH_ON_DISABLED
        elif clears:
            self._woken, self._supply_cut, self._emergency = True, False, None
            self._tell_faults()
        if not self._woken or self._state not in _UPWARDS:
            return State402.CW_DISABLE_VOLTAGE
        wanted = _UPWARDS[self._state]
        return wanted if command.enable else min(wanted, State402.CW_SWITCH_ON)

    def _configure(self) -> None:
        node, options = self._node, self._options
        mode, supported = _MODES[options.mode]
        node.set_network_state("PRE-OPERATIONAL")  # a stopped node answers no SDO
        node.write(0x6040, 0, State402.CW_DISABLE_VOLTAGE, 2)
        kind = node.read(0x1000) & 0xFFFF
        if kind != PROFILE:
            raise RigFault(
                f"CANopen node {options.node_id} has the profile {kind}, not {PROFILE}: it is no drive"
            )
        self._firmware = Firmware(protocol=PROFILE, version=node.version())
        if not node.read(0x6502) & supported:
            raise RigFault(f"CANopen node {options.node_id} has no mode {options.mode}; see links.drive.mode")
        consumer = self._host_id << 16 | options.lost_host_ms
        for index, subindex, value, size_bytes in (
            (0x1016, 1, consumer, 4),
            (0x1029, 1, KEEP_STATE, 1),
            (0x6007, 0, QUICK_STOP, 2),
            (0x605A, 0, STOP_AND_DISABLE, 2),
        ):
            node.write(index, subindex, value, size_bytes)
            if node.read(index, subindex) != value:
                raise RigFault(
                    f"CANopen node {options.node_id} does not keep {value:#x} in object"
                    f" {index:#06x}:{subindex}: it would not stop for a lost host"
                )
        node.write(0x60FF, 0, 0, 4)
        node.write(0x6060, 0, mode, 1)
        if options.mode == "csv":
            node.write(0x60C2, 1, max(round(self._host.tick_s * 1e3), 1), 1)
            node.write(0x60C2, 2, -3, 1)
        # an unused PDO has bit 31 set, one that is not asked for by remote frames bit 30
        self._map(0x1400, 0x1600, self._command_id, 0, 255, (0x60400010, 0x60FF0020))
        self._map(0x1800, 0x1A00, self._status_id, 0x40000000, 1, (0x60410010, 0x60640020, 0x603F0010))
        node.set_network_state("OPERATIONAL")

    def _map(
        self,
        settings: int,
        mapping: int,
        frame_id: int,
        flags: int,
        transmission: int,
        objects: tuple[int, ...],
    ) -> None:
        """Give a PDO its objects, in the order of CiA 301 7.5.2.36: off, objects, on."""
        node = self._node
        node.write(settings, 1, 0x80000000 | flags | frame_id, 4)
        node.write(settings, 2, transmission, 1)
        node.write(mapping, 0, 0, 1)
        for place, entry in enumerate(objects, 1):
            node.write(mapping, place, entry, 4)
        node.write(mapping, 0, len(objects), 1)
        node.write(settings, 1, flags | frame_id, 4)

    def _receive(self, frame_id: int, data: bytes, now_s: float) -> None:
        if frame_id == self._status_id and len(data) == _STATUS.size and self._set_up:
            status, position, error_code = _STATUS.unpack(data)
            self._take(status, position, error_code, now_s)
        elif frame_id == self._emergency_id:
            self._take_emergency(data)
        elif frame_id == self._boot_id and data == b"\x00":
            self._set_up = self._woken = self.referenced = False
            self._starts += 1
            self.state, self._state = DriveState.SILENT, "NOT READY TO SWITCH ON"
        elif frame_id in self._masters:
            # Neither slcan nor SocketCAN gives us our own frames back: this is another master's.
            self.foreign_commands += 1
        else:
            self._node.receive(frame_id, data, now_s)

    def _take(self, status: int, position: int, error_code: int, now_s: float) -> None:
        """A status: one that no SYNC asked for, of no known state, or from too far away is none."""
        asked_s = self._answers.answered(now_s)
        state = next((name for name, (mask, bits) in State402.SW_MASK.items() if status & mask == bits), "")
        if asked_s is None or not state:
            return
        if self._units is None:
            self._units, self._zero_rad = position, position * self._unit_rad
        moved = (position - self._units + 2**31) % 2**32 - 2**31
        if abs(moved * self._unit_rad) > JUMP_RAD + FASTEST_RAD_S * (
            now_s - max(self._taken_s, self._set_up_s)
        ):
            return
        self._units += moved
        self.angle_rad = self._units * self._unit_rad - self._zero_rad
        self._sampled_s, self._taken_s = asked_s, now_s
        self._error_code, self.supply_on = error_code, bool(status & _VOLTAGE_ENABLED)
        self._supply_cut |= self._woken and not self.supply_on and _STATES[state] is DriveState.SILENT
        self._enter(state)
        self._tell_faults()
        self._counter += 1
        row = (now_s, asked_s, float(self._counter), self.angle_rad, float(self.state), float(self.faults))
        self._host.record("drive", row)

    def _enter(self, state: str) -> None:
        before, self.state, self._state = self.state, _STATES[state], state
        if before in _AWAKE and self.state not in _AWAKE:
            self._woken = False
        goes_on = self._passed and self.state in _AWAKE
        if goes_on or (before is DriveState.FAULT and self.state is not DriveState.FAULT):
            self._emergency = None

    def _take_emergency(self, data: bytes) -> None:
        """One that has passed (code 0) is forgotten when the drive goes on; what stopped it, at a clear."""
        said = decode_emergency(data)
        if said is None:
            return
        self._passed = said[0] < 0x0100
        # a drive without power misses its host as a node does that is silent: that is no fault
        if not self._passed and (self._woken or said[0] != NO_HEARTBEAT):
            self._emergency = said
        self._tell_faults()

    def _tell_faults(self) -> None:
        code = self._emergency[0] if self._emergency is not None else 0
        if not code and self.state is DriveState.FAULT:
            code = self._error_code
        self.faults = _fault_of(code) | (DriveFault.EMERGENCY_STOP if self._supply_cut else DriveFault.NONE)


class SyncAnswers:
    """Which SYNC an answer belongs to: they come in order, and some may be lost.

    While one has been open for too long no further SYNC goes out, until all are answered or the open ones are
    lost. They are lost at once where answers came steadily until then and stopped with the SYNCs: late ones
    would still come. They are lost after 50 ms where the answers had stopped before. So a value is never
    said to be younger than it is; one after a lost answer is said to be a tick older, until then.
    """

    def __init__(self, tick_s: float) -> None:
        self._asked_s: deque[float] = deque()
        self._answered_s = -math.inf
        self._steady_s = _TICKS_OPEN * tick_s
        self._late_s = max(_LATE_S, self._steady_s)

    def ask(self, now_s: float) -> bool:
        """Whether a SYNC may go out now."""
        if self._asked_s and now_s - self._asked_s[0] >= self._late_s - _ROUNDING_S:
            newest_s = self._asked_s[-1]
            steady = self._answered_s >= newest_s - self._steady_s
            if now_s - max(self._answered_s, newest_s) < (_QUIET_S if steady else _LOST_S) - _ROUNDING_S:
                return False
            self._asked_s.clear()
        self._asked_s.append(now_s)
        return True

    def answered(self, now_s: float) -> float | None:
        """When the SYNC went out that an answer at `now_s` belongs to; None when none is open."""
        self._answered_s = now_s
        return self._asked_s.popleft() if self._asked_s else None


def _fault_of(code: int) -> DriveFault:
    """The bit of an error code; NONE for those that have no bit, whose text tells them."""
    if code in _FAULTS:
        return _FAULTS[code]
    if code & 0xFF00 in (0x8100, 0x8200):
        return DriveFault.FRAME
    return DriveFault.ENCODER if code & 0xFF00 == 0x7300 else DriveFault.NONE


_FAULTS = {
    NO_HEARTBEAT: DriveFault.HEARTBEAT,
    0x8250: DriveFault.COMMAND_AGE,
    0x8611: DriveFault.STALL,
}
