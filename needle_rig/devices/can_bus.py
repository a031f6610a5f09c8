"""A CAN bus of python-can in an asyncio loop: frames in as they come, frames out without waiting."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable, Iterator

import can
from can.interfaces.slcan import slcanBus

from needle_rig.config.schema import CanSection
from needle_rig.devices.device import FrameHandler
from needle_rig.devices.ports import claim, claim_interface, interface_reason, port_reason
from needle_rig.devices.terminal_reader import TerminalReader
from needle_rig.errors import RigFault

_FRAMES_A_WAKE = 512
_FRAME_LETTERS = frozenset((b"t", b"T", b"r", b"R"))


class CanLink:
    """Owns the bus. A bus that dies stays silent: its death shows in the ages of what came over it."""

    def __init__(self, config: CanSection, on_frame: FrameHandler, now: Callable[[], float] = time.monotonic):
        self._config = config
        self._on_frame = on_frame
        self._now = now
        self._bus: can.BusABC | None = None
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
            self._bus = _open_bus(self._config)
        except (can.CanError, OSError, ValueError) as error:
            self._release()
            self.trouble = f"{place}: {_reason(error, self._config)}; see links.can in the rig file"
            raise RigFault(self.trouble) from error
        if isinstance(self._bus, _Slcan):
            self._terminal = TerminalReader(self._bus.fileno(), self._feed, self._on_end, self._now)
        else:
            self._reader = _Reader(self._bus, self._receive, self._on_lost)
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
            self._bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=False), timeout=0)
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
            with contextlib.suppress(can.CanError, OSError):  # a port that is gone cannot be told
                self._bus.shutdown()
            self._bus = None
        if self._lock_fd is not None:
            os.close(self._lock_fd)
            self._lock_fd = None

    def _on_lost(self, error: Exception) -> None:
        self.lost, self.trouble = True, f"CAN bus ({self.place}): {_reason(error, self._config)}"

    def _on_end(self, error: OSError) -> None:
        self._on_lost(can.CanOperationError(f"the adapter is gone: {error.strerror}"))

    def _feed(self, data: bytes, now_s: float) -> None:
        """What an slcan adapter sent."""
        assert isinstance(self._bus, _Slcan)
        for message in self._bus.messages(data):
            self._pass_on(message, now_s)

    def _receive(self, message: can.Message) -> None:
        self._pass_on(message, self._now())

    def _pass_on(self, message: can.Message, now_s: float) -> None:
        if not (message.is_extended_id or message.is_error_frame or message.is_remote_frame):
            self._on_frame(message.arbitration_id, bytes(message.data), now_s)


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
    """python-can's slcan that is given what was read and never waits for the adapter to drain.

    The original reads byte by byte (two system calls each: a fifth of a core at 2000 frames/s) and calls
    tcdrain after each frame, which an adapter that hangs can hold for seconds.
    """

    def shutdown(self) -> None:
        """Close the channel and the port; the port also when the adapter cannot be told."""
        try:
            super().shutdown()
        finally:
            self.serialPortOrig.close()

    def _write(self, string: str) -> None:
        line = string.encode() + self.LINE_TERMINATOR
        try:
            sent = os.write(self.serialPortOrig.fileno(), line)
        except OSError as error:
            raise can.CanOperationError(f"the adapter takes nothing: {error.strerror}") from error
        if sent != len(line):
            raise can.CanOperationError("the adapter's buffer is full")

    def messages(self, data: bytes) -> Iterator[can.Message]:
        """The frames that end in `data`; lines that are no frame are left out."""
        *lines, rest = (bytes(self._buffer) + data).replace(self._ERROR, self._OK).split(self._OK)
        # No slcan line of a classic frame is longer than 32 bytes: more without an end is noise.
        self._buffer = bytearray(rest[-64:])
        for line in lines:
            if line[:1] in _FRAME_LETTERS:
                self._queue.put_nowait(line.decode("ascii", "replace"))
                with contextlib.suppress(ValueError, IndexError):
                    if (message := self._recv_internal(0)[0]) is not None:
                        yield message

    def _read(self, timeout: float | None) -> str | None:  # noqa: ARG002 as python-can calls it
        return self._queue.get_nowait() if self._queue.qsize() else None


def _open_bus(config: CanSection) -> can.BusABC:
    if config.interface == "slcan":
        return _Slcan(config.channel, bitrate=config.bitrate_kbit_s * 1000, sleep_after_open=0)
    # SocketCAN takes its bit rate from `ip link`.
    return can.Bus(interface=config.interface, channel=config.channel)


def _reason(error: Exception, config: CanSection) -> str:
    code = error.error_code if isinstance(error, can.CanError) else getattr(error, "errno", None)
    if config.interface == "socketcan" and code is not None:
        return interface_reason(code, config.channel)
    if isinstance(error, OSError) and error.filename:
        return port_reason(error, str(error.filename))
    return str(error).split("\n")[0]
