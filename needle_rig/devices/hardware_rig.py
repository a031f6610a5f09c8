"""The rig behind its ports: torque and drive nodes on CAN, Hall node on serial."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable

from needle_rig.config.files import find_config_file
from needle_rig.config.schema import RigConfig
from needle_rig.devices.can_bus import CanLink
from needle_rig.devices.drive_can import DriveCan
from needle_rig.devices.hall_serial import HallSerial
from needle_rig.devices.torque_can import TorqueCan
from needle_rig.errors import BadInput, RigFault
from needle_rig.records import STOP, Command, Measurement
from needle_rig.rig import RawReadings
from needle_rig.wire.can_frames import (
    CanCodec,
    DriveCommand,
    DriveHealth,
    DriveReference,
    DriveStatus,
    TorqueStatus,
)
from needle_rig.wire.hall_frames import HallFrame

_POLL_S = 0.005
_LAST_STOPS = 3
_RETRY_S = 0.5
_FRESH_S = 0.1


class HardwareRig:
    """A `Rig` made of the links of `config`. `raw` receives every reading whose checksum was right."""

    def __init__(
        self,
        config: RigConfig,
        raw: RawReadings | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        for key, port in (("can.channel", config.links.can.channel), ("hall.port", config.links.hall.port)):
            if port == "auto":
                raise BadInput(
                    f"links.{key}: auto is the port of a simulated rig, which nobody has started; name a port"
                )
        self._links = config.links
        self._now = now
        self._codec = CanCodec(find_config_file("needle_rig.dbc"))
        self._can = CanLink(config.links.can, self._on_frame, now)
        self._torque = TorqueCan(self._codec.torque_clock_period_s, raw)
        self._drive = DriveCan(self._codec, self._can.send, raw)
        sensors = tuple(sensor.name for sensor in config.layout.hall_sensors)
        self._hall = HallSerial(config.links.hall, sensors, raw, now, self._base_now)
        self._watching: asyncio.TimerHandle | None = None
        self._foreign_commands = 0

    async def open(self, timeout_s: float = 3.0) -> None:
        """Connect and wait for the first reading of every link; RigFault names a missing one and its port.

        Stop commands go out meanwhile, so that the drive knows its host before it is asked to move.
        """
        try:
            self._can.open()
            self._hall.open()
            self._watch()
            deadline_s = self._now() + timeout_s
            while missing := self._missing():
                if self._now() > deadline_s:
                    raise RigFault(f"no reading within {timeout_s:g} s from the {' and the '.join(missing)}")
                self.write(STOP)
                await asyncio.sleep(_POLL_S)
        except BaseException:
            await self.close()
            raise

    def read(self) -> Measurement:
        """Newest values with their ages; never blocks."""
        # After a pause of this process the ports hold frames that the loop has not brought yet; judged by
        # what it has brought, every link would look dead.
        self._can.poll()
        self._hall.poll()
        now_s = self._now()
        return Measurement(
            time_s=now_s,
            base_angle_rad=self._drive.angle_rad,
            torque_nm=self._torque.torque_nm,
            hall_rad=self._hall.angle_rad,
            drive_state=self._drive.state,
            drive_faults=self._drive.faults,
            torque_age_s=self._torque.age_s(now_s),
            hall_age_s=self._hall.age_s(now_s),
            drive_age_s=self._drive.age_s(now_s),
            torque_complaint=self._can.trouble or self._torque.complaint,
            hall_complaint=self._hall.complaint,
            referenced=self._drive.referenced,
            supply_on=self._drive.supply_on,
            emergency_stop=self._drive.emergency_stop,
            index_rad=self._drive.index_rad,
            foreign_commands=self._foreign_commands,
        )

    @property
    def hall_frame(self) -> HallFrame | None:
        """The newest frame of the Hall node, with its field amplitudes."""
        return self._hall.frame

    def write(self, command: Command) -> None:
        """Send one command; never blocks. A dead link shows in the ages of later readings."""
        self._drive.command(command)
        if command.reference_rad is not None:
            self._hall.refer(command.reference_rad)

    async def close(self) -> None:
        """Stop the drive and release every port; safe to call twice."""
        if self._watching is not None:
            self._watching.cancel()
        for _ in range(_LAST_STOPS):
            self.write(STOP)
        self._can.close()
        await self._hall.close()

    def _watch(self) -> None:
        """Open again what was pulled out and put back; the ages tell the brain when it works."""
        for link in (self._can, self._hall):
            if link.lost:
                with contextlib.suppress(RigFault):
                    link.open()
        self._watching = asyncio.get_running_loop().call_later(_RETRY_S, self._watch)

    def _on_frame(self, frame_id: int, data: bytes, now_s: float) -> None:
        content = self._codec.decode(frame_id, data)
        if isinstance(content, TorqueStatus):
            self._torque.take(content, now_s)
        elif isinstance(content, DriveStatus):
            self._drive.take(content, now_s)
        elif isinstance(content, DriveHealth):
            self._drive.take_health(content, now_s)
        elif isinstance(content, DriveCommand | DriveReference):
            # Neither slcan nor SocketCAN gives us our own frames back: this is another master's.
            self._foreign_commands += 1

    def _base_now(self) -> float:
        """The base's angle, for the Hall sensors' turns; NaN when it is old."""
        fresh = self._drive.age_s(self._now()) <= _FRESH_S
        return self._drive.angle_rad if fresh else math.nan

    def _missing(self) -> list[str]:
        """The links without a first reading, as a person would look for them."""
        now_s = self._now()
        can = f"{self._links.can.interface} {self._links.can.channel}"
        found = (
            (self._torque.age_s(now_s), "torque link", can, self._can.trouble or self._torque.complaint),
            (self._drive.age_s(now_s), "drive link", can, self._drive.complaint(now_s)),
            (self._hall.age_s(now_s), "Hall link", self._links.hall.port, self._hall.complaint),
        )
        return [
            f"{name} ({port}{': ' + complaint if complaint else ''})"
            for age_s, name, port, complaint in found
            if math.isinf(age_s)
        ]
