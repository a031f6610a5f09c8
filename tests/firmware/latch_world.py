"""The production brain and the drive node's own guard in virtual time, with links that delay and lose frames.

The needle is a spring behind a slip clutch: a second costs some 30 ms. `Watch` holds both to what a latch
promises, at every millisecond.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.errors import NeedleRigError
from needle_rig.firmware.host import HostNodes
from needle_rig.records import (
    Command,
    DriveFault,
    DriveState,
    Measurement,
)
from needle_rig.units import deg, nm, rad
from tests.firmware.latch_watch import Watch

CONFIG = load_rig_config(
    None,
    {
        "sequence.settle_s": 0.2,
        "sequence.torque_window_s": 0.1,
        **{f"links.{link}_age_limit_ms": 50 for link in ("torque", "hall", "drive")},
    },
)
TICK_MS = 5
HEALTH_MS = 10
SLIP_RAD = rad(26.0)
"""The clutch gives at this twist, the shipped needle's."""
SPRING_NM_RAD = nm(0.1007) / SLIP_RAD
HALL_RAD_NM = tuple(rad(lag) / nm(0.1007) for lag in (19.6, 23.2, 25.3, 26.0))
OVERLOAD_NM = nm(2.5)
"""Above the trip of the node and the limit of the host, 2 N·mm each."""
SHORT_MDEG_MS = 20.0
"""A shorted power stage turns the base at 20°/s whenever it has its supply."""


@dataclass
class Broken:
    """What is wrong now; every default is a healthy rig."""

    drive_link: bool = False
    command_link: bool = False
    torque_host: bool = False
    torque_node: bool = False
    hall: bool = False
    emergency_stop: bool = False
    encoder: bool = False
    overload: bool = False
    heartbeat: bool = False
    short: bool = False
    blocked: bool = False


@dataclass(frozen=True)
class Status:
    """What the drive node says in one millisecond."""

    angle_rad: float
    state: DriveState
    faults: DriveFault
    emergency_stop: bool
    supply: bool
    referenced: bool
    health: bool
    """DRIVE_HEALTH goes out too."""


@dataclass
class World:
    """One rig and its host; `order` lets a person speak, `pass_ms` lets time go by."""

    nodes: HostNodes
    config: Any = CONFIG
    broken: Broken = field(default_factory=Broken)
    up_ms: int = 0
    down_ms: int = 0
    now_ms: int = 0
    pause_ms: int = 0

    def __post_init__(self) -> None:
        ffi, self.lib = self.nodes.ffi, self.nodes.lib
        self.guard: Any = ffi.new("struct nr_guard *")
        self._senses: Any = ffi.new("struct nr_senses *")
        self._frame: Any = ffi.new("struct nr_command *")
        self._node_config: Any = ffi.addressof(self.lib.nr_drive_defaults, "guard")
        self.lib.nr_guard_init(self.guard, self._node_config)
        self.brain = Brain(self.config)
        self.watch = Watch()
        self.true_mdeg = self.zero_mdeg = 0.0
        self.tip_rad = 0.0
        self.torque_nm = 0.0
        self.command = Command()
        self.measurement = Measurement(0.0, 0.0, 0.0, (0.0,) * 4)
        self.permitted = 0
        self._sent = self._heartbeat = 0
        self._up: deque[tuple[int, Status]] = deque()
        self._down: deque[tuple[int, Command, int, int]] = deque()
        self._at_ms = {"torque": -math.inf, "hall": -math.inf, "drive": -math.inf, "health": -math.inf}
        self._health: tuple[Any, ...] = ()
        self._health_ms = -HEALTH_MS
        self._step_ms = 0
        self.pass_ms(20)

    @property
    def state(self) -> DriveState:
        """The node's."""
        return DriveState(self.guard.state)

    @property
    def faults(self) -> DriveFault:
        """The node's."""
        return DriveFault(self.guard.faults)

    def order(self, what: str) -> bool:
        """What a person asks; False when it is refused, which changes nothing."""
        brain, angle_rad = self.brain, rad((self.true_mdeg - self.zero_mdeg) * 1e-3)
        deeds: dict[str, Callable[[], object]] = {
            "clear": brain.clear,
            "jog": lambda: brain.jog(by_rad=rad(8.0 if angle_rad < 0.0 else -8.0)),
            "hold": brain.hold,
            "release": brain.release,
            "stop": lambda: brain.stop("a person"),
            "home": brain.home,
            "hall": lambda: brain.home("hall"),
            "here": lambda: brain.home("here", angle_rad),
            "compensate": lambda: brain.compensate(
                Request(0.0, "protocol", {"steps_deg": (6.0, -6.0)}, settle_s=0.2)
            ),
        }
        before = self.measurement
        try:
            deeds[what]()
        except NeedleRigError:
            return False
        self.watch.ordered(what, self.now_ms, before.drive_faults)
        return True

    def fail(self, part: str, milliseconds: int) -> None:
        """`part` is broken for a while."""
        setattr(self.broken, part, True)
        self.pass_ms(milliseconds)
        setattr(self.broken, part, False)

    def foreign(self) -> None:
        """Another master speaks in a sequence of its own; the host hears it where the bus reaches it."""
        for _ in range(5):
            self._receive(Command(), (self.guard.last_counter + 7) % 16, self.guard.last_heartbeat + 99)
        if not self.broken.drive_link:
            count = self.measurement.foreign_commands + 5
            self.measurement = replace(self.measurement, foreign_commands=count)

    def damage(self) -> None:
        """A dozen frames for the node arrive damaged."""
        for _ in range(12):
            self.lib.nr_guard_bad_frame(self.guard)

    def restart(self) -> None:
        """The node's supply fails for a moment."""
        self.lib.nr_guard_init(self.guard, self._node_config)
        self.permitted = 0
        self.watch.restarted()

    def pass_ms(self, milliseconds: int) -> None:
        """Let time go by, and look at every millisecond of it."""
        for _ in range(milliseconds):
            self._step()

    def _step(self) -> None:
        self.now_ms += 1
        while self._down and self._down[0][0] <= self.now_ms:
            _, command, counter, heartbeat = self._down.popleft()
            self._receive(command, counter, heartbeat)
        self._turn()
        if not self.broken.torque_node:
            torque = round(self.torque_nm * 1e3 * 1e5)
            self.lib.nr_guard_torque(self.guard, self.now_ms * 1000, torque, True)
        senses = self._senses
        senses.angle_mdeg = round(self.true_mdeg - self.zero_mdeg)
        senses.encoder_good = not self.broken.encoder
        senses.emergency_stop = self.broken.emergency_stop
        self.permitted = self.lib.nr_guard_step(self.guard, self.now_ms * 1000, senses, self.permitted)
        self._tell()
        if self.pause_ms > 0:
            self.pause_ms -= 1
        elif self.now_ms - self._step_ms >= TICK_MS:
            self._tick()
        self.watch.look(self)

    def _turn(self) -> None:
        """The base follows as the node's own model of its motor does."""
        if self.guard.supply and self.broken.short:
            self.true_mdeg += SHORT_MDEG_MS
        elif not self.broken.blocked:
            self.true_mdeg += self.guard.motion.expected_q8 / 256 * 1e-4
        base_rad = rad(self.true_mdeg * 1e-3)
        self.tip_rad = base_rad - min(max(base_rad - self.tip_rad, -SLIP_RAD), SLIP_RAD)
        self.torque_nm = SPRING_NM_RAD * (base_rad - self.tip_rad)
        if self.broken.overload:
            self.torque_nm += OVERLOAD_NM

    def _tell(self) -> None:
        guard = self.guard
        flags = (guard.faults >> 8, guard.supply, self.broken.emergency_stop, guard.referenced)
        health = flags != self._health or self.now_ms - self._health_ms >= HEALTH_MS
        if health:
            self._health, self._health_ms = flags, self.now_ms
        if self.broken.drive_link:
            return
        angle_rad = rad((self.true_mdeg - self.zero_mdeg) * 1e-3)
        said = Status(
            angle_rad,
            self.state,
            self.faults,
            self.broken.emergency_stop,
            bool(guard.supply),
            bool(guard.referenced),
            health,
        )
        due_ms = max(self.now_ms + self.up_ms, self._up[-1][0] if self._up else 0)
        self._up.append((due_ms, said))

    def _hear(self, at_ms: int, said: Status) -> None:
        self._at_ms["drive"] = at_ms
        faults = said.faults & 0xFF | self.measurement.drive_faults & ~0xFF
        if said.health:
            self._at_ms["health"] = at_ms
            faults = said.faults
            self.measurement = replace(
                self.measurement,
                referenced=said.referenced,
                supply_on=said.supply,
                emergency_stop=said.emergency_stop,
            )
        self.measurement = replace(
            self.measurement, base_angle_rad=said.angle_rad, drive_state=said.state, drive_faults=faults
        )

    def _read(self) -> Measurement:
        now_ms, at_ms = self.now_ms, self._at_ms
        while self._up and self._up[0][0] <= now_ms:
            self._hear(*self._up.popleft())
        if not self.broken.torque_host:
            at_ms["torque"] = now_ms
            self.measurement = replace(self.measurement, torque_nm=self.torque_nm)
        if not self.broken.hall:
            at_ms["hall"] = now_ms
            base_rad = rad((self.true_mdeg - self.zero_mdeg) * 1e-3)
            twist_nm = SPRING_NM_RAD * (rad(self.true_mdeg * 1e-3) - self.tip_rad)
            hall_rad = tuple(base_rad - compliance * twist_nm for compliance in HALL_RAD_NM)
            self.measurement = replace(self.measurement, hall_rad=hall_rad)
        drive_ms = max(now_ms - at_ms["drive"], now_ms - at_ms["health"] - HEALTH_MS)
        return replace(
            self.measurement,
            time_s=now_ms * 1e-3,
            torque_age_s=(now_ms - at_ms["torque"]) * 1e-3,
            hall_age_s=(now_ms - at_ms["hall"]) * 1e-3,
            drive_age_s=drive_ms * 1e-3,
        )

    def _tick(self) -> None:
        dt_s, self._step_ms = (self.now_ms - self._step_ms) * 1e-3, self.now_ms
        self.measurement = self._read()
        self.command, _ = self.brain.step(self.measurement, dt_s)
        self.watch.ticked(self)
        if self.command.release:
            return
        self._sent += 1
        if not self.broken.heartbeat:
            self._heartbeat += 1
        if self.broken.command_link:
            return
        due_ms = max(self.now_ms + self.down_ms, self._down[-1][0] if self._down else 0)
        self._down.append((due_ms, self.command, self._sent % 16, self._heartbeat))

    def _receive(self, command: Command, counter: int, heartbeat: int) -> None:
        frame, now_us = self._frame, self.now_ms * 1000
        frame.velocity = round(deg(command.velocity_rad_s) * 1e4)
        frame.enable, frame.clear, frame.acknowledge = command.enable, command.clear, command.acknowledge
        frame.sight_us = math.ceil(min(command.sight_s, 1e3) * 200 - 1e-9) * 5000
        frame.counter, frame.heartbeat = counter, heartbeat % 65536
        self.lib.nr_guard_command(self.guard, now_us, frame)
        if command.reference_rad is None:
            return
        angle_mdeg = round(deg(command.reference_rad) * 1e3)
        if self.lib.nr_guard_reference(self.guard, now_us, heartbeat % 65536, angle_mdeg):
            self.zero_mdeg = self.true_mdeg - angle_mdeg
