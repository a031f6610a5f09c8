"""A CAN bus made of pseudo-terminals: each port speaks slcan like a USB adapter, the hub joins them."""

from __future__ import annotations

import contextlib
import os
import re
import tty
from collections.abc import Callable
from typing import Protocol

from needle_rig.wire.slcan import ERROR, OK, slcan_line

Frame = tuple[int, bytes]

_FRAME = re.compile(rb"t([0-9A-Fa-f]{3})([0-8])((?:[0-9A-Fa-f]{2})*)")
_QUEUE_BYTES = 4096


class CanPort(Protocol):
    """An adapter between the hub and another program."""

    name: str

    def fileno(self) -> int:
        """Descriptor to wait on for what the program sends."""

    def receive(self) -> list[Frame]:
        """Frames that the program sent."""

    def send(self, frame: Frame) -> None:
        """Queue a frame for the program."""

    def send_garbled(self, frame: Frame, garble: Callable[[bytes], bytes]) -> None:
        """Queue what `garble` leaves of a frame."""

    def flush(self) -> None:
        """Send what is queued."""

    def close(self) -> None:
        """Hang up; safe to call twice."""


class Pty:
    """A pseudo-terminal whose other end a program opens by `name`; writing never waits."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        # Raw before anybody opens it: a terminal would echo what it is sent. The slave stays open here, so
        # that a program that leaves does not hang up the port for the next one.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.name = os.ttyname(self._slave)
        self._pending = b""
        self.lost = 0
        """How many writes found no room, as when nobody reads."""

    def fileno(self) -> int:
        """Descriptor to wait on for bytes from the program."""
        return self._master

    def read(self) -> bytes:
        """What the program wrote; empty when nothing is there."""
        try:
            return os.read(self._master, 65536)
        except OSError:
            return b""

    def write(self, data: bytes) -> None:
        """Queue `data` whole or drop it whole, as an adapter does when its buffer is full."""
        if len(self._pending) + len(data) > _QUEUE_BYTES:
            self.lost += 1
        else:
            self._pending += data

    def flush(self) -> None:
        """Send what is queued, or as much as there is room for."""
        if self._pending:
            with contextlib.suppress(BlockingIOError):
                sent = os.write(self._master, self._pending)
                self._pending = self._pending[sent:]

    def close(self) -> None:
        """Hang up, as when the cable is pulled; safe to call twice."""
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1


class SlcanPort(Pty):
    """One adapter: channel commands and frames as ASCII lines (LAWICEL)."""

    def __init__(self) -> None:
        super().__init__()
        self._line = b""
        self.is_open = False
        """Whether the program opened the channel."""

    def receive(self) -> list[Frame]:
        """Frames that the program sent; its channel commands are answered."""
        *lines, self._line = (self._line + self.read()).split(b"\r")
        self._line = self._line[-64:]
        return [frame for line in lines if (frame := self._obey(line)) is not None]

    def send(self, frame: Frame) -> None:
        """Pass a frame on to the program if it opened the channel."""
        if self.is_open:
            self.write(slcan_line(*frame))

    def send_garbled(self, frame: Frame, garble: Callable[[bytes], bytes]) -> None:
        """Send noise in place of the frame's line, whether the channel is open or not."""
        self.write(garble(slcan_line(*frame)))

    def _obey(self, line: bytes) -> Frame | None:
        match = _FRAME.fullmatch(line)
        if match and self.is_open and len(match[3]) == 2 * int(match[2]):
            self.write(b"z\r")
            return int(match[1], 16), bytes.fromhex(match[3].decode())
        if line in (b"O", b"L", b"C"):
            self.is_open = line != b"C"
            self.write(OK)
        elif line == b"V":
            self.write(b"V0101\r")
        elif line == b"" or (line[:1] == b"S" and line[1:].isdigit()):
            self.write(OK)
        else:
            self.write(ERROR)
        return None


class SlcanHub:
    """Every frame reaches every other port and every node on this side, as on one pair of wires."""

    def __init__(self) -> None:
        self.ports: list[CanPort] = []
        self._nodes: list[Callable[[Frame], None]] = []

    def add_port(self) -> SlcanPort:
        """One more adapter on the bus."""
        port = SlcanPort()
        self.plug(port)
        return port

    def plug(self, port: CanPort) -> None:
        """Put an adapter on the bus."""
        self.ports.append(port)

    def remove_port(self, port: CanPort) -> None:
        """Pull an adapter out."""
        self.ports.remove(port)
        port.close()

    def attach(self, node: Callable[[Frame], None]) -> None:
        """Let `node` hear every frame that it did not send itself."""
        self._nodes.append(node)

    def send(self, frame: Frame, sender: object = None) -> None:
        """Put a frame on the bus."""
        for port in self.ports:
            if port is not sender:
                port.send(frame)
        for node in self._nodes:
            if node != sender:
                node(frame)

    def flush(self) -> None:
        """Let every port send; call it once for the frames of one moment, as USB does."""
        for port in self.ports:
            port.flush()

    def serve(self, port: CanPort) -> None:
        """Pass on what came into `port`."""
        for frame in port.receive():
            self.send(frame, sender=port)
