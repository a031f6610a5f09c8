"""The rig behind its ports: drive, torque sensor and Hall sensors as the rig file names them."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from typing import ParamSpec, Protocol, TypeVar

from needle_rig.config.schema import RigConfig
from needle_rig.devices.can_bus import CanLink
from needle_rig.devices.device import (
    BytePort,
    BytesHandler,
    CanPort,
    Device,
    Drive,
    FrameHandler,
    Frames,
    HallSensors,
    Host,
    Link,
    TorqueSensor,
)
from needle_rig.devices.ethernet import UdpPort, fetch_page
from needle_rig.devices.library import make_device
from needle_rig.devices.serial_line import SerialLine
from needle_rig.errors import BadInput, RigFault
from needle_rig.records import STOP, Command, Firmware, Measurement
from needle_rig.rig import RawReadings
from needle_rig.wire.hall_frames import HallFrame

_POLL_S = 0.005
_LAST_STOPS = 3
_RETRY_S = 0.5
_FRESH_S = 0.1
_INTRODUCED_S = 0.75
"""A node of this project introduces itself every half second; an older one never does."""

_Kind = TypeVar("_Kind", bound=Device)
_Given = ParamSpec("_Given")


class RigHost(Host, Protocol):
    """A host for all devices of a rig. `links` are those that were asked for; `kind` says by whom."""

    links: list[Link]
    kind: str
    defects: dict[str, str]
    """By kind: how its device failed on what it was handed."""


class RealHost:
    """Real ports for the devices of one rig."""

    def __init__(self, config: RigConfig, raw: RawReadings | None, now: Callable[[], float]) -> None:
        self.sensors = tuple(sensor.name for sensor in config.layout.hall_sensors)
        self.tick_s = 1.0 / config.tick_hz
        self.now = now
        self.base_rad: Callable[[], float] = lambda: math.nan
        self.links: list[Link] = []
        self.kind = ""
        self.defects: dict[str, str] = {}
        self._raw = raw
        self._can_section = config.links.can
        self._bus: CanLink | None = None
        self._listeners: list[tuple[str, FrameHandler]] = []

    def record(self, source: str, row: tuple[float, ...]) -> None:
        """See `Host.record`."""
        if self._raw is not None:
            self._raw(source, row)

    def can(self, received: FrameHandler) -> CanPort:
        """See `Host.can`; all devices share it."""
        if self._bus is None:
            self._bus = CanLink(self._can_section, self._on_frames, self.now, self.tick_s)
            self.links.append(self._bus)
        self._listeners.append((self.kind, received))
        return self._bus

    def serial(self, port: str, baud: int, received: BytesHandler) -> BytePort:
        """See `Host.serial`."""
        line = SerialLine(self.kind, port, baud, self._guarded(received), self.now, self.tick_s)
        self.links.append(line)
        return line

    def udp(self, address: str, port: int, received: BytesHandler) -> BytePort:
        """An open UDP port to `address`, whose datagrams `received` gets; see `Host.udp`."""
        made = UdpPort(self.kind, address, port, self._guarded(received), self.now)
        self.links.append(made)
        return made

    async def page(self, address: str, port: int, path: str) -> bytes:
        """See `Host.page`."""
        return await asyncio.to_thread(fetch_page, address, port, path)

    def _guarded(self, received: Callable[_Given, None]) -> Callable[_Given, None]:
        """`received`, whose defect makes its own link old and does not end the tick."""
        kind = self.kind

        def guarded(*given: _Given.args, **named: _Given.kwargs) -> None:
            try:
                received(*given, **named)
            except Exception as error:  # noqa: BLE001 a device of one's own may raise anything
                self._defect(kind, error)

        return guarded

    def _on_frames(self, frames: Frames, now_s: float) -> None:
        """Frame by frame in the order of the bus; a device's defect costs it the frame alone."""
        for frame_id, data in frames:
            for kind, received in self._listeners:
                try:
                    received(frame_id, data, now_s)
                except Exception as error:  # noqa: BLE001 as above
                    self._defect(kind, error)

    def _defect(self, kind: str, error: Exception) -> None:
        self.defects[kind] = f"its device has a defect: {type(error).__name__}: {error}"


class HardwareRig:
    """A `Rig` made of the devices of `config`. `raw` receives every reading whose checksum was right."""

    def __init__(
        self,
        config: RigConfig,
        raw: RawReadings | None = None,
        now: Callable[[], float] = time.monotonic,
        host: RigHost | None = None,
    ) -> None:
        """`host` stands in for this computer's ports."""
        for key, port in config.links.ports.items():
            if port == "auto":
                raise BadInput(
                    f"links.{key}: auto is the port of a simulated rig, which nobody has started; name a port"
                )
        self._now = now
        self._host: RigHost = RealHost(config, raw, now) if host is None else host
        self._drive = self._made(config, "drive", Drive)
        self._torque = self._made(config, "torque", TorqueSensor)
        self._hall = self._made(config, "hall", HallSensors)
        self._kinds: dict[Device, str] = {self._torque: "torque", self._drive: "drive", self._hall: "hall"}
        self._host.base_rad = self._base_now  # type: ignore[method-assign]
        self._watching: asyncio.TimerHandle | None = None
        self._set_ups: dict[Device, asyncio.Task[None]] = {}
        self._trouble: dict[Device, str] = {}

    async def open(self, timeout_s: float = 3.0) -> None:
        """Connect and wait for the first reading of every device; RigFault names a missing one and its port.

        A node is given the time in which it says what it is: before, a motion could begin with one whose
        protocol is not known.

        Stop commands go out meanwhile, so that the drive knows its host before it is asked to move.
        """
        try:
            for link in self._host.links:
                link.open()
            for device in self._kinds:
                await device.set_up()
            self._watch()
            begun_s = self._now()
            while (missing := self._missing()) or self._not_introduced(self._now() - begun_s):
                if missing and self._now() > begun_s + timeout_s:
                    raise RigFault(f"no reading within {timeout_s:g} s from the {' and the '.join(missing)}")
                self.write(STOP)
                await asyncio.sleep(_POLL_S)
                self._poll()
        except BaseException:
            await self.close()
            raise

    def read(self) -> Measurement:
        """Newest values with their ages; never blocks."""
        # After a pause of this process the ports hold frames that the loop has not brought yet; judged by
        # what it has brought, every link would look dead.
        self._poll()
        now_s = self._now()
        drive, torque, hall = self._drive, self._torque, self._hall
        return Measurement(
            time_s=now_s,
            base_angle_rad=drive.angle_rad,
            torque_nm=torque.torque_nm,
            hall_rad=hall.angle_rad,
            drive_state=drive.state,
            drive_faults=drive.faults,
            torque_age_s=torque.age_s(now_s),
            hall_age_s=hall.age_s(now_s),
            drive_age_s=drive.age_s(now_s),
            torque_complaint=self._complaint(torque, now_s),
            hall_complaint=self._complaint(hall, now_s),
            drive_complaint=self._complaint(drive, now_s),
            referenced=drive.referenced,
            supply_on=drive.supply_on,
            emergency_stop=drive.emergency_stop,
            index_rad=drive.index_rad,
            foreign_commands=drive.foreign_commands,
        )

    def firmware(self) -> dict[str, Firmware]:
        """See `Rig.firmware`."""
        now_s = self._now()
        told = {kind: device.firmware(now_s) for device, kind in self._kinds.items()}
        return {kind: firmware for kind, firmware in told.items() if firmware is not None}

    @property
    def hall_frame(self) -> HallFrame | None:
        """The newest frame of the Hall node, with its field amplitudes; None where another device stands."""
        return getattr(self._hall, "frame", None)

    def write(self, command: Command) -> None:
        """Send one command; never blocks. A dead link shows in the ages of later readings."""
        self._drive.command(command)
        if command.reference_rad is not None:
            self._hall.refer(command.reference_rad)

    async def close(self) -> None:
        """Stop the drive and release every port; safe to call twice."""
        if self._watching is not None:
            self._watching.cancel()
        for task in self._set_ups.values():
            task.cancel()
        await asyncio.gather(*self._set_ups.values(), return_exceptions=True)
        self._set_ups.clear()
        for _ in range(_LAST_STOPS):
            self.write(STOP)
        for device in self._kinds:
            device.shut_down()
        for link in self._host.links:
            await link.close()

    def _made(self, config: RigConfig, kind: str, of: type[_Kind]) -> _Kind:
        self._host.kind = kind
        device = make_device(config.links, kind, self._host)
        assert isinstance(device, of)
        return device

    def _poll(self) -> None:
        for link in self._host.links:
            link.poll()

    def _watch(self) -> None:
        """Open again what was pulled out and put back, and set up a device that started again; the ages tell
        the brain when it works.
        """
        for link in self._host.links:
            if link.lost:
                with contextlib.suppress(RigFault):
                    link.open()
        for device in self._kinds:
            busy = device in self._set_ups and not self._set_ups[device].done()
            if not busy and not device.link.lost and device.needs_set_up(self._now()):
                self._set_ups[device] = asyncio.create_task(self._set_up(device), name="set up a device")
        self._watching = asyncio.get_running_loop().call_later(_RETRY_S, self._watch)

    async def _set_up(self, device: Device) -> None:
        self._trouble.pop(device, None)
        try:
            await device.set_up()
        except RigFault as fault:
            self._trouble[device] = str(fault)

    def _complaint(self, device: Device, now_s: float) -> str:
        defect = self._host.defects.get(self._kinds[device], "")
        return device.link.trouble or defect or device.complaint(now_s) or self._trouble.get(device, "")

    def _base_now(self) -> float:
        """The base's angle, for the Hall sensors' turns; NaN when it is old."""
        fresh = self._drive.age_s(self._now()) <= _FRESH_S
        return self._drive.angle_rad if fresh else math.nan

    def _not_introduced(self, since_s: float) -> bool:
        """Whether a node may still be about to say what it is."""
        return since_s < _INTRODUCED_S and any(told.protocol is None for told in self.firmware().values())

    def _missing(self) -> list[str]:
        """The devices without a first reading, as a person would look for them."""
        now_s = self._now()
        found = ((self._torque, "torque link"), (self._drive, "drive link"), (self._hall, "Hall link"))
        missing: list[str] = []
        for device, name in found:
            if math.isinf(device.age_s(now_s)):
                complaint = self._complaint(device, now_s)
                missing.append(f"{name} ({device.link.place}{': ' + complaint if complaint else ''})")
        return missing
