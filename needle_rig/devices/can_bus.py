"""A CAN bus of python-can in an asyncio loop: frames in as they come, frames out without waiting."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
import os
import time
from collections.abc import Callable

import can
from can.interfaces.slcan import slcanBus

from needle_rig.config.schema import CanSection
from needle_rig.devices.device import Frames
from needle_rig.devices.ports import claim, claim_interface, interface_reason, port_reason
from needle_rig.devices.terminal_reader import TerminalReader
from needle_rig.errors import RigFault
from needle_rig.wire.slcan import SlcanStream, slcan_line

_FRAMES_A_WAKE = 512


class CanLink:
    """Owns the bus. A bus that dies stays silent: its death shows in the ages of what came over it."""

    def __init__(
        self,
        config: CanSection,
        on_frames: Callable[[Frames, float], None],
        now: Callable[[], float] = time.monotonic,
        tick_s: float = math.inf,
    ) -> None:
        """`tick_s` is from one `poll` to the next, where there is a tick."""
        self._config = config
        self._on_frames = on_frames
        self._now, self._tick_s = now, tick_s
        self._bus: can.BusABC | None = None
        self._write: Callable[[int, bytes], None]
        self._reader: _Reader | None = None
        self._terminal: TerminalReader | None = None
        self._lock_fd: int | None = None
        self.place = f"{config.interface} {config.channel}"
        self.lost = False
        """Whether the adapter went away."""
        self.trouble = ""
        """Why it is lost, for a person; empty while it is not."""

    def open(self) -> None:
        """Claim the port and listen in the running loop. Raises RigFault in one sentence."""
        self._release()
        place = f"CAN bus ({self.place})"
        try:
            if self._config.interface == "slcan":
                self._lock_fd = claim(self._config.channel.partition("@")[0])
            elif self._config.interface == "socketcan":
                self._lock_fd = claim_interface(self._config.channel)
            bus = self._bus = _open_bus(self._config)
        except (can.CanError, OSError, ValueError) as error:
            self._release()
            self.trouble = f"{place}: {_reason(error, self._config)}; see links.can in the rig file"
            raise RigFault(self.trouble) from error
        if isinstance(bus, _Slcan):
            received = functools.partial(self._feed, bus.stream)
            self._terminal = TerminalReader(bus.fileno(), received, self._on_end, self._now, self._tick_s)
            self._write = bus.write
        else:
            self._reader = _Reader(bus, self._receive, self._on_lost)
            self._write = functools.partial(_write, bus)
        self.lost, self.trouble = False, ""

    def poll(self) -> None:
        """Take what has arrived and the loop has not brought yet."""
        if self._terminal is not None:
            self._terminal.drain()
        elif self._bus is not None and self._reader is not None and not self.lost:
            self._reader.drain(self._bus)

    def send(self, frame_id: int, data: bytes) -> bool:
        """Hand one frame to the bus, at once or not at all; False when it was not taken."""
        if self._bus is None or self.lost:
            return False
        try:
            self._write(frame_id, data)
        except (can.CanError, OSError):
            return False
        return True

    async def close(self) -> None:
        """Stop listening and release the port; safe to call twice."""
        self._release()

    def _release(self) -> None:
        if self._reader is not None:
            self._reader.stop()
            self._reader = None
        if self._terminal is not None:
            self._terminal.close()
            self._terminal = None
        if self._bus is not None:
            with contextlib.suppress(can.CanError, OSError):  # a port that is gone cannot be closed in order
                self._bus.shutdown()
            self._bus = None
        if self._lock_fd is not None:
            os.close(self._lock_fd)
            self._lock_fd = None

    def _on_lost(self, error: Exception) -> None:
        self.lost, self.trouble = True, f"CAN bus ({self.place}): {_reason(error, self._config)}"

    def _on_end(self, error: OSError) -> None:
        self._on_lost(can.CanOperationError(f"the adapter is gone: {error.strerror}"))

    def _feed(self, stream: SlcanStream, data: bytes, now_s: float) -> None:
        """What an slcan adapter sent."""
        self._on_frames(stream.feed(data), now_s)

    def _receive(self, message: can.Message) -> None:
        if not (message.is_extended_id or message.is_error_frame or message.is_remote_frame):
            self._on_frames([(message.arbitration_id, bytes(message.data))], self._now())


class _Reader(can.Notifier):
    """python-can's Notifier on the loop, for a bus that may bring noise or die.

    As it comes, the Notifier takes one frame a wake-up, and a dead descriptor wakes the loop for ever.
    """

    def __init__(
        self, bus: can.BusABC, receive: Callable[[can.Message], None], on_lost: Callable[[Exception], None]
    ) -> None:
        self._on_lost = on_lost
        self.descriptor: int | None
        try:
            self.descriptor = bus.fileno()
        except NotImplementedError:
            self.descriptor = None
        super().__init__(bus, [receive], timeout=0.1, loop=asyncio.get_running_loop())

    def drain(self, bus: can.BusABC) -> None:
        """Pass on every frame that waits; a bus without a descriptor has a thread that does it."""
        if self.descriptor is not None:
            self._on_message_available(bus)

    def _on_message_available(self, bus: can.BusABC) -> None:
        for _ in range(_FRAMES_A_WAKE):
            try:
                message = bus.recv(0)
            except (ValueError, IndexError):
                continue  # an slcan line that is not a frame
            except (can.CanError, OSError) as error:
                self._on_lost(error)
                if self.descriptor is not None:
                    asyncio.get_running_loop().remove_reader(self.descriptor)
                return
            if message is None:
                return
            self._on_message_received(message)


class _Slcan(slcanBus):
    """python-can's slcan to open a channel and to send; it never waits for the adapter to drain.

    The original reads byte by byte (two system calls each: a fifth of a core at 2000 frames/s) and calls
    tcdrain after each frame, which an adapter that hangs can hold for seconds.
    """

    def __init__(self, channel: str, bitrate: int) -> None:
        self.stream = SlcanStream()
        super().__init__(channel, bitrate=bitrate, sleep_after_open=0)

    def shutdown(self) -> None:
        """Close the channel and the port; the port also when the adapter does not hear it."""
        try:
            super().shutdown()
        finally:
            self.serialPortOrig.close()

    def write(self, frame_id: int, data: bytes) -> None:
        """Send one plain frame."""
        self._send(slcan_line(frame_id, data))

    def _write(self, string: str) -> None:
        self._send(string.encode() + self.LINE_TERMINATOR)

    def _send(self, line: bytes) -> None:
        try:
            sent = os.write(self.serialPortOrig.fileno(), line)
        except OSError as error:
            raise can.CanOperationError(f"the adapter takes nothing: {error.strerror}") from error
        if sent != len(line):
            raise can.CanOperationError("the adapter's buffer is full")


def _open_bus(config: CanSection) -> can.BusABC:
    if config.interface == "slcan":
        return _Slcan(config.channel, config.bitrate_kbit_s * 1000)
    # SocketCAN takes its bit rate from `ip link`.
    return can.Bus(interface=config.interface, channel=config.channel)


def _write(bus: can.BusABC, frame_id: int, data: bytes) -> None:
    bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=False), timeout=0)


def _reason(error: Exception, config: CanSection) -> str:
    code = error.error_code if isinstance(error, can.CanError) else getattr(error, "errno", None)
    if config.interface == "socketcan" and code is not None:
        return interface_reason(code, config.channel)
    if isinstance(error, OSError) and error.filename:
        return port_reason(error, str(error.filename))
    return str(error).split("\n")[0]
