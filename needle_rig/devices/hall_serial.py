"""The Hall node on its serial port: angles of all sensors, unwrapped, with their age."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable

import serial
import serial_asyncio_fast

from needle_rig.config.schema import SerialSection
from needle_rig.devices.link_clock import LinkClock
from needle_rig.devices.ports import port_reason
from needle_rig.errors import RigFault
from needle_rig.rig import RawReadings
from needle_rig.wire.hall_frames import CLOCK_PERIOD_S, HallFrame, HallStream
from needle_rig.wire.hall_turns import HallTurns

_READ_BYTES = 65536


class HallSerial(asyncio.Protocol):
    """Newest angle of every sensor. A sensor whose magnet is out of reach keeps its value and grows old.

    `base` gives the base's angle in rad, NaN while it is not known: after an outage it tells the turns.
    """

    def __init__(
        self,
        config: SerialSection,
        sensors: tuple[str, ...],
        raw: RawReadings | None = None,
        now: Callable[[], float] = time.monotonic,
        base: Callable[[], float] = lambda: math.nan,
    ) -> None:
        self._config = config
        self._sensors = sensors
        self._raw = raw
        self._now = now
        self._stream = HallStream()
        self._clock = LinkClock(CLOCK_PERIOD_S)
        self._turns = HallTurns(sensors)
        self._base = base
        self._misfit = ""
        self._port: serial.Serial | None = None
        self._transport: asyncio.Transport | None = None
        self._closed: asyncio.Future[None] | None = None
        self.frame: HallFrame | None = None
        """The newest frame, with its field amplitudes; for calibration."""
        self.lost = False
        """Whether the port went away."""

    @property
    def angle_rad(self) -> tuple[float, ...]:
        """Unwrapped angles in the order of the sensors; NaN before the first."""
        return self._turns.angle_rad

    @property
    def complaint(self) -> str:
        """What is wrong with frames that do come, for the message of a missing link."""
        return self._misfit or self._turns.complaint

    def refer(self, base_rad: float) -> None:
        """The base stands at `base_rad`: sensors whose turns were lost take those nearest to it."""
        self._turns.refer(base_rad)

    def age_s(self, now_s: float) -> float:
        """Age of the oldest sensor's newest value; infinite until every sensor gave one."""
        return max(self._clock.age_s(now_s), now_s - self._turns.healthy_s)

    def open(self) -> None:
        """Claim the port and listen. Raises RigFault in one sentence."""
        loop = asyncio.get_running_loop()
        place = f"Hall link ({self._config.port})"
        try:
            port = self._port = serial.Serial(self._config.port, self._config.baud, exclusive=True)
        except (OSError, ValueError) as error:
            reason = port_reason(error, self._config.port) if isinstance(error, OSError) else str(error)
            raise RigFault(f"{place}: {reason}; see links.hall in the rig file") from error
        with contextlib.suppress(ValueError, OSError, NotImplementedError):
            port.set_low_latency_mode(
                True
            )  # USB adapters else hold bytes back for 16 ms; a pty has no such mode
        self._closed = loop.create_future()
        self._transport = serial_asyncio_fast.SerialTransport(loop, self, port)
        self.lost = False

    async def close(self) -> None:
        """Release the port; safe to call twice."""
        if self._transport is not None and self._closed is not None:
            self._transport.close()
            await self._closed
            self._transport = self._port = None

    def poll(self) -> None:
        """Take what has arrived and the loop has not brought yet."""
        if self._port is not None and self._transport is not None and not self._transport.is_closing():
            with contextlib.suppress(OSError):  # a port that is gone shows in the ages
                if data := self._port.read(_READ_BYTES):
                    self.data_received(data)

    def data_received(self, data: bytes) -> None:
        """Bytes from the port."""
        now_s = self._now()
        for frame in self._stream.feed(data):
            self._take(frame, now_s)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 see asyncio.Protocol
        """The port is closed, or gone; the angles grow old."""
        self.lost = True
        if self._closed is not None and not self._closed.done():
            self._closed.set_result(None)

    def _take(self, frame: HallFrame, now_s: float) -> None:
        if self._raw is not None:
            self._raw("hall", (now_s, frame.node_time_s, float(frame.counter), *frame.angle_rad))
        if len(frame.angle_rad) != len(self._sensors):
            self._misfit = (
                f"the node sends {len(frame.angle_rad)} sensors, layout.hall_sensors has {len(self._sensors)}"
            )
            return
        self._misfit = ""
        if not self._clock.accept(frame.counter, frame.node_time_s, now_s):
            return
        self.frame = frame
        self._turns.take(frame, now_s, self._base())
