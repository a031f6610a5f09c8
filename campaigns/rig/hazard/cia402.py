"""The rig with a drive of another make: the production CiA 402 driver and its twin in virtual time."""

from __future__ import annotations

import asyncio
import math
import struct
from collections import deque
from dataclasses import replace

from campaigns.rig.hazard.setups import Setup
from needle_rig.config.schema import Cia402Drive
from needle_rig.devices.drive_cia402 import DriveCia402
from needle_rig.devices.memory_host import SOME_TIME_S, MemoryCan, MemoryHost
from needle_rig.records import Command, DriveState, Measurement
from needle_rig.simulation.build import build_plant
from needle_rig.simulation.faults import Faults, Links
from needle_rig.simulation.nodes.cia402_node import Cia402Node
from needle_rig.simulation.nodes.front_end import ENCODER_COUNTS_PER_DEG
from needle_rig.units import deg

STEP_S = 0.001
OPTIONS = Cia402Drive(device="cia402", node_id=5, position_units_per_turn=36000, velocity_units_per_rpm=60)
_COMMAND_ID, _SYNC_ID = 0x200 + OPTIONS.node_id, 0x080
_ENABLED = 0x0F
_COMMUNICATION = (0x8100, 0x8200)
"""Classes of codes that pass with their cause."""


class _Bus(MemoryCan):
    """While the driver sets its drive up, each frame is answered at once: so a set-up needs no clock."""

    def __init__(self, rig: Cia402Rig, host: MemoryHost) -> None:
        super().__init__(host)
        self._rig = rig

    def send(self, frame_id: int, data: bytes) -> bool:
        self._rig.say(frame_id, data)
        return True


class _Host(MemoryHost):
    """The driver's host, whose bus leads to the rig."""

    def __init__(self, rig: Cia402Rig, tick_s: float) -> None:
        super().__init__(tick_s=tick_s)
        self._rig = rig

    def can(self, received: object) -> MemoryCan:
        super().can(received)  # type: ignore[arg-type]
        return _Bus(self._rig, self)

    def record(self, source: str, row: tuple[float, ...]) -> None:
        """Nobody reads them here."""


class Cia402Rig:
    """Implements `hazard.rigs.Rig`. Torque and Hall angles are the plant's own readings.

    A stage that turns the motor by itself does so while the drive has its power on: a supply line that the
    host could open, such a drive has not.
    """

    def __init__(self, setup: Setup, seed: int) -> None:
        self.plant = build_plant(setup.config(seed))
        ways = self.plant.links
        self.links = Links(torque=ways.torque, hall=ways.hall, hall_faded=ways.hall_faded)
        self._late_s, self._bundle_ms = setup.late_ms * 1e-3, setup.bundle_ms
        self._node = Cia402Node(OPTIONS)
        self._host = _Host(self, setup.tick_ms * 1e-3)
        self._setting_up = False
        self._failed = 0
        self._steps = 0
        self._on_way: deque[tuple[float, int, bytes]] = deque()
        self._driver = DriveCia402(OPTIONS, self._host)
        self._velocity_rad_s = 0.0
        self._drive()  # it says that it started
        self._set_up()

    @property
    def time_s(self) -> float:
        return self.plant.time_s

    @property
    def faults(self) -> Faults:
        return self.plant.faults

    @property
    def true_base_rad(self) -> float:
        return self.plant.true_base_rad

    @property
    def awake(self) -> bool:
        return self._node.state in (DriveState.READY, DriveState.RUNNING)

    @property
    def running(self) -> bool:
        return self._node.powered

    @property
    def latched(self) -> bool:
        return self._node.state is DriveState.FAULT and bool(self._failed)

    def say(self, frame_id: int, data: bytes) -> None:
        """A frame of the host on its way to the drive."""
        arrived = self.links.command.through(data, self.time_s, frame_id)
        if arrived is None:
            return
        self._node.receive(self._now_us, frame_id, arrived)
        if self._setting_up:
            for answer in self._drive():
                self._host.bring(*answer)

    def step(self) -> None:
        """Motor and needle, the drive, and its answers on their way to the host."""
        node, plant = self._node, self.plant
        plant.supply_on = node.supply_on and node.powered
        plant.turn(self._velocity_rad_s, STEP_S, powered=node.powered)
        self._steps += 1
        self._host.now_s = SOME_TIME_S + plant.time_s
        for frame_id, data in self._drive():
            reached = self.links.drive.through(data, plant.time_s, frame_id)
            if reached is not None:
                self._on_way.append((plant.time_s + self._late_s, frame_id, reached))
        if self._steps % self._bundle_ms == 0:
            while self._on_way and self._on_way[0][0] <= plant.time_s + 1e-9:
                _, frame_id, data = self._on_way.popleft()
                self._host.bring(frame_id, data)
        if self._driver.needs_set_up(self._host.now_s) and not (
            self.links.drive.fault or self.links.command.fault
        ):
            self._set_up()

    def read(self) -> Measurement:
        """The driver's values beside the plant's torque and Hall angles."""
        driver, now_s = self._driver, self._host.now_s
        return replace(
            self.plant.read(),
            time_s=self.plant.time_s,
            base_angle_rad=driver.angle_rad,
            drive_state=driver.state,
            drive_faults=driver.faults,
            drive_age_s=driver.age_s(now_s),
            drive_complaint=driver.complaint(now_s),
            referenced=driver.referenced,
            supply_on=driver.supply_on,
            emergency_stop=driver.emergency_stop,
            index_rad=driver.index_rad,
            foreign_commands=driver.foreign_commands,
        )

    def write(self, command: Command) -> None:
        """What the production rig does each tick."""
        if command.clear:
            self._failed = 0
        self._driver.command(command)

    def reset_drive(self) -> None:
        self._node.reset(self._now_us)
        self._failed = 0

    def fail_drive(self, code: int) -> None:
        self._node.fail(code)
        self._failed = 0 if code & 0xFF00 in _COMMUNICATION else code

    def foreign(self, wish: Command, *, number: int) -> None:
        """Its frames have no counter: `number` says nothing here."""
        units = round(wish.velocity_rad_s * OPTIONS.velocity_units_per_rpm * 60.0 / math.tau)
        for frame_id, data in ((_COMMAND_ID, struct.pack("<Hi", _ENABLED, units)), (_SYNC_ID, b"")):
            self._node.receive(self._now_us, frame_id, data)
            self._host.bring(frame_id, data)

    def foreign_reference(self, angle_rad: float) -> None:
        """The zero of such a drive is kept by the host."""
        raise NotImplementedError

    @property
    def _now_us(self) -> int:
        return round(self.plant.time_s * 1e6)

    def _drive(self) -> tuple[tuple[int, bytes], ...]:
        counts = round(deg(self.plant.read().base_angle_rad) * ENCODER_COUNTS_PER_DEG)
        stop = self.faults.emergency_stop
        frames, self._velocity_rad_s = self._node.step(self._now_us, counts, emergency_stop=stop)
        return frames

    def _set_up(self) -> None:
        self._setting_up = True
        asyncio.run(self._driver.set_up())
        self._setting_up = False
