"""A serial port in an asyncio loop: bytes in as they come, bytes out without waiting."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable

import serial

from needle_rig.devices.device import BytesHandler
from needle_rig.devices.ports import port_reason
from needle_rig.devices.terminal_reader import TerminalReader
from needle_rig.errors import RigFault


class SerialLine:
    """Owns the port. One that dies stays silent: its death shows in the ages of what came over it."""

    def __init__(
        self,
        name: str,
        port: str,
        baud: int,
        received: BytesHandler,
        now: Callable[[], float] = time.monotonic,
        tick_s: float = math.inf,
    ) -> None:
        """`name` is what a person calls the link, `torque`, `hall` or `drive` as below `links`.

        `tick_s` is from one `poll` to the next, where there is a tick.
        """
        self._name, self._baud = name, baud
        self._received, self._now, self._tick_s = received, now, tick_s
        self._port: serial.Serial | None = None
        self._reader: TerminalReader | None = None
        self.place = port
        self.lost = False
        self.trouble = ""

    def open(self) -> None:
        """Claim the port and listen, anew after it was lost. Raises RigFault in one sentence."""
        self._release()
        try:
            port = self._port = serial.Serial(
                self.place, self._baud, timeout=0, write_timeout=0, exclusive=True
            )
        except (OSError, ValueError) as error:
            reason = port_reason(error, self.place) if isinstance(error, OSError) else str(error)
            title = self._name.capitalize()
            raise RigFault(
                f"{title} link ({self.place}): {reason}; see links.{self._name} in the rig file"
            ) from error
        with contextlib.suppress(ValueError, OSError, NotImplementedError):
            # USB adapters else hold bytes back for 16 ms; a pty has no such mode
            port.set_low_latency_mode(True)
        self._reader = TerminalReader(port.fileno(), self._received, self._on_end, self._now, self._tick_s)
        self.lost = False

    async def close(self) -> None:
        """Release the port; safe to call twice."""
        self._release()

    def _release(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None
        if self._port is not None:
            with contextlib.suppress(OSError):  # a port that is gone cannot be closed in order
                self._port.close()
            self._port = None

    def poll(self) -> None:
        """Take what has arrived and the loop has not brought yet."""
        if self._reader is not None:
            self._reader.drain()

    def send(self, data: bytes) -> bool:
        """Write `data` whole, at once or not at all."""
        if self._port is None or self.lost:
            return False
        try:
            return os.write(self._port.fileno(), data) == len(data)
        except OSError:
            return False

    def _on_end(self, error: OSError) -> None:  # noqa: ARG002 what is gone shows in the ages
        self.lost = True
