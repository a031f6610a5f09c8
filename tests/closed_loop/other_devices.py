"""A rig in virtual time behind a CiA 402 drive, an ATI sensor and lines of text: drivers against twins."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable, Coroutine
from typing import Any

from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import Cia402Drive, NetFtTorque, RigConfig, TextHall
from needle_rig.devices.device import BytesHandler, FrameHandler, Link
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.devices.memory_host import MemoryBytes, MemoryCan, MemoryHost
from needle_rig.records import Command, Measurement
from needle_rig.simulation.build import build_plant
from needle_rig.simulation.nodes.cia402_node import Cia402Node
from needle_rig.simulation.nodes.front_end import inputs
from needle_rig.simulation.nodes.netft_sensor import NetFtSensor
from needle_rig.simulation.nodes.text_sensors import TextSensors

STEP_S = 1e-3
DRIVE = Cia402Drive(device="cia402", node_id=5, position_units_per_turn=409_600, velocity_units_per_rpm=100)
TORQUE = NetFtTorque(device="netft", address="192.168.1.1")
HALL = TextHall(device="text", port="/dev/none", checksum=True)


def config_of(drive: Cia402Drive = DRIVE, torque: NetFtTorque = TORQUE, hall: TextHall = HALL) -> RigConfig:
    limits = {f"links.{link}_age_limit_ms": 50 for link in ("torque", "hall", "drive")}
    config = load_rig_config(None, limits)
    can = config.links.can.model_copy(update={"channel": "virtual"})
    links = config.links.model_copy(update={"can": can, "drive": drive, "torque": torque, "hall": hall})
    return config.model_copy(update={"links": links})


class VirtualHost(MemoryHost):
    """One host for three devices, whose bytes it keeps apart."""

    def __init__(self, config: RigConfig, page: Callable[[], bytes]) -> None:
        super().__init__(tuple(sensor.name for sensor in config.layout.hall_sensors), 1.0 / config.tick_hz)
        self.links: list[Link] = []
        self.kind = ""
        self.defects: dict[str, str] = {}
        self.pages = {"netftapi2.xml": page()}
        self.to_sensor: list[bytes] = []
        self.hear: dict[str, BytesHandler] = {}

    def can(self, received: FrameHandler) -> MemoryCan:
        self.links.append(super().can(received))
        return MemoryCan(self)

    def serial(self, port: str, baud: int, received: BytesHandler) -> MemoryBytes:
        self.hear[self.kind] = received
        link = MemoryBytes(self, port)
        self.links.append(link)
        return link

    def udp(self, address: str, port: int, received: BytesHandler) -> MemoryBytes:
        return self.serial(address, port, received)


class VirtualRig:
    """Plant, twins and drivers. `fault` by link is silence, garble or freeze on the way to the host."""

    def __init__(self, config: RigConfig) -> None:
        links = config.links
        assert isinstance(links.drive, Cia402Drive)
        assert isinstance(links.torque, NetFtTorque)
        assert isinstance(links.hall, TextHall)
        self.plant = build_plant(config)
        self.drive, self.sensor = Cia402Node(links.drive), NetFtSensor(links.torque)
        self.text = TextSensors(links.hall)
        self.host = VirtualHost(config, self.sensor.page)
        self.rig = HardwareRig(config, now=self.host.now, host=self.host)
        self.fault = {"torque": "", "drive": "", "hall": ""}
        self.host_alive = True
        self._velocity_rad_s = 0.0
        self._last: dict[tuple[str, int], bytes] = {}
        self._random = random.Random(1)
        self._steps = 0
        asyncio.run(self._open())

    async def _open(self) -> None:
        for device in (self.rig._torque, self.rig._drive, self.rig._hall):
            await self.set_up(device.set_up())
        for _ in range(20):
            self.rig.write(Command())
            self.advance(0.005)

    async def set_up(self, doing: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(doing)
        while not task.done():
            self.advance(STEP_S)
            await asyncio.sleep(0)
        await task

    @property
    def time_s(self) -> float:
        return self.plant.time_s

    @property
    def true_base_rad(self) -> float:
        return self.plant.true_base_rad

    def shaft_rad(self) -> object:
        return self.plant.shaft_rad()

    def read(self) -> Measurement:
        return self.rig.read()

    def write(self, command: Command) -> None:
        if self.host_alive:
            self.rig.write(command)

    def advance(self, dt_s: float) -> None:
        for _ in range(round(dt_s / STEP_S)):
            self._step()

    def _step(self) -> None:
        self._steps += 1
        now_us, host, plant = self._steps * 1000, self.host, self.plant
        host.now_s += STEP_S
        while host.sent:
            frame_id, data = host.sent.popleft()
            if frame_id == 0 and len(data) == 8:
                self.sensor.receive(data)
            else:
                self.drive.receive(now_us, frame_id, data)
        plant.supply_on = self.drive.supply_on
        plant.turn(self._velocity_rad_s, STEP_S, powered=self.drive.powered)
        counts = inputs(plant.read())
        frames, self._velocity_rad_s = self.drive.step(
            now_us, counts.encoder, emergency_stop=plant.faults.emergency_stop
        )
        for frame_id, data in frames:
            if (arrived := self._through("drive", data, frame_id)) is not None:
                host.bring(frame_id, arrived)
        for link, data in (
            ("torque", self.sensor.step(now_us, counts.torque)),
            ("hall", self.text.step(now_us, counts.hall)),
        ):
            if data and (arrived := self._through(link, data)) is not None:
                host.hear[link](arrived, host.now_s)

    def _through(self, link: str, data: bytes, frame_id: int = 0) -> bytes | None:
        fault = self.fault[link]
        if fault == "silence":
            return None
        if fault == "garble":
            return self._random.randbytes(len(data))
        if fault == "freeze":
            return self._last.get((link, frame_id))
        self._last[link, frame_id] = data
        return data


def lag_deg(rig: VirtualRig) -> float:
    return math.degrees(rig.true_base_rad - float(rig.plant.hall_rad[-1]))
