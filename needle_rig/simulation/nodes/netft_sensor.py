"""A force-torque sensor with Ethernet as its maker describes it: RDT over UDP, its page over HTTP.

Of ATI, Net F/T manual 9620-05-NET FT, chapters 9.1 and 10.
"""

from __future__ import annotations

import contextlib
import socket
import struct

from needle_rig.config.schema import NetFtTorque
from needle_rig.simulation.nodes.front_end import TORQUE_COUNTS_PER_NMM, TORQUE_FULL_SCALE

COUNTS_PER_NM = 64_000_000
"""As a small transducer has it: 15.6 nN·m a count."""
INTERNAL_RATE_HZ = 7000
SATURATED = 0x80020000
"""Error, and transducer saturation."""

_REQUEST = struct.Struct("!HHI")
_PAGE_S = 0.01


class NetFtSensor:
    """Records without end from a start until a stop."""

    def __init__(self, options: NetFtTorque) -> None:
        self._axis = "xyz".index(options.axis)
        self._way = -1 if options.reversed else 1
        self.reset(0)

    def reset(self, now_us: int) -> None:
        """It is switched on: silent, its samples counted from zero."""
        self._start_us = now_us
        self._left: int | None = 0
        self._sequence = 0

    def page(self) -> bytes:
        """netftapi2.xml: what it was set to."""
        return (
            '<?xml version="1.0" encoding="ISO-8859-1"?>\n<netft>\n<prodname>Net F/T</prodname>\n'
            "<runstat>0x00000000</runstat>\n<scfgfu>N</scfgfu>\n<scfgtu>N-m</scfgtu>\n<cfgcpf>1000000</cfgcpf>\n"
            f"<cfgcpt>{COUNTS_PER_NM}</cfgcpt>\n<comrdte>Enabled</comrdte>\n<comrdtrate>1000</comrdtrate>\n"
            f"<runrate>{INTERNAL_RATE_HZ}</runrate>\n</netft>\n"
        ).encode()

    def receive(self, data: bytes) -> None:
        """A request; what is none is ignored."""
        if len(data) != _REQUEST.size:
            return
        header, command, count = _REQUEST.unpack(data)
        if header != 0x1234:
            return
        if command == 0:
            self._left = 0
        elif command in (2, 3):
            self._left, self._sequence = (count or None), 0

    def step(self, now_us: int, torque_counts: int) -> bytes:
        """The record of one sample; empty while nobody asked."""
        if self._left == 0:
            return b""
        if self._left is not None:
            self._left -= 1
        self._sequence = (self._sequence + 1) % 2**32
        sample = (now_us - self._start_us) * INTERNAL_RATE_HZ // 1_000_000 % 2**32
        status = SATURATED if abs(torque_counts) >= TORQUE_FULL_SCALE else 0
        torque = [0, 0, 0]
        torque[self._axis] = self._way * round(torque_counts * COUNTS_PER_NM * 1e-3 / TORQUE_COUNTS_PER_NMM)
        return struct.pack("!3I6i", self._sequence, sample, status, 0, 0, 0, *torque)


class NetFtPorts:
    """The sensor's ports on this computer alone, free ones: RDT and HTTP."""

    def __init__(self, sensor: NetFtSensor) -> None:
        self.sensor = sensor
        self._client: tuple[str, int] | None = None
        self._rdt = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._rdt.bind(("127.0.0.1", 0))
        self._rdt.setblocking(False)
        self._http = socket.create_server(("127.0.0.1", 0))
        self._http.setblocking(False)
        self.plugged = True

    @property
    def place(self) -> str:
        """address:RDT port:HTTP port."""
        return f"127.0.0.1:{self._rdt.getsockname()[1]}:{self._http.getsockname()[1]}"

    @property
    def waited_on(self) -> list[socket.socket]:
        """What brings requests."""
        return [self._rdt, self._http]

    def serve(self, ready: socket.socket) -> None:
        """Take one request from a port of `waited_on`; without its plug nothing reaches the sensor."""
        if ready is self._rdt:
            with contextlib.suppress(OSError):
                data, sender = self._rdt.recvfrom(2048)
                if self.plugged:
                    self._client = sender
                    self.sensor.receive(data)
            return
        with contextlib.suppress(OSError), self._http.accept()[0] as browser:
            browser.settimeout(_PAGE_S)
            if self.plugged and browser.recv(4096).startswith(b"GET /netftapi2.xml"):
                page = self.sensor.page()
                head = f"HTTP/1.0 200 OK\r\nContent-Type: text/xml\r\nContent-Length: {len(page)}\r\n\r\n"
                browser.sendall(head.encode() + page)
            elif self.plugged:
                browser.sendall(b"HTTP/1.0 404 Not Found\r\n\r\n")

    def send(self, data: bytes) -> None:
        """Send a record to whoever asked last."""
        if data and self.plugged and self._client is not None:
            with contextlib.suppress(OSError):
                self._rdt.sendto(data, self._client)

    def close(self) -> None:
        """Close the ports."""
        self._rdt.close()
        self._http.close()
