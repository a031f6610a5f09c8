"""A serial port in an asyncio loop: bytes in as they come, bytes out without waiting."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable

import serial
import serial_asyncio_fast

from needle_rig.devices.device import BytesHandler
from needle_rig.devices.ports import port_reason
from needle_rig.errors import RigFault

_READ_BYTES = 65536


class SerialLine(asyncio.Protocol):
    """Owns the port. One that dies stays silent: its death shows in the ages of what came over it."""

    def __init__(
        self,
        name: str,
        port: str,
        baud: int,
        received: BytesHandler,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """`name` is what a person calls the link, `torque`, `hall` or `drive` as below `links`."""
        self._name, self._baud = name, baud
        self._received, self._now = received, now
        self._port: serial.Serial | None = None
        self._transport: asyncio.Transport | None = None
        self._closed: asyncio.Future[None] | None = None
        self.place = port
        self.lost = False
        self.trouble = ""

    def open(self) -> None:
        """Claim the port and listen. Raises RigFault in one sentence."""
        loop = asyncio.get_running_loop()
        try:
            port = self._port = serial.Serial(self.place, self._baud, exclusive=True)
        except (OSError, ValueError) as error:
            reason = port_reason(error, self.place) if isinstance(error, OSError) else str(error)
            title = self._name.capitalize()
            raise RigFault(
                f"{title} link ({self.place}): {reason}; see links.{self._name} in the rig file"
            ) from error
        with contextlib.suppress(ValueError, OSError, NotImplementedError):
            # USB adapters else hold bytes back for 16 ms; a pty has no such mode
            port.set_low_latency_mode(True)
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

    def send(self, data: bytes) -> bool:
        """Write `data` whole, at once or not at all."""
        if self._port is None or self.lost:
            return False
        try:
            return os.write(self._port.fileno(), data) == len(data)
        except OSError:
            return False

    def data_received(self, data: bytes) -> None:
        """Bytes from the port."""
        self._received(data, self._now())

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 see asyncio.Protocol
        """The port is closed, or gone."""
        self.lost = True
        if self._closed is not None and not self._closed.done():
            self._closed.set_result(None)
