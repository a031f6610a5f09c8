"""Devices on the network: datagrams to and from one address, and the page that a device serves."""

from __future__ import annotations

import contextlib
import http
import http.client
import socket
import time
from collections.abc import Callable

from needle_rig.devices.device import BytesHandler
from needle_rig.devices.ports import network_reason
from needle_rig.errors import RigFault

_DATAGRAM_BYTES = 2048
_READ_AT_MOST = 1024
_RECEIVE_BYTES = 1 << 20
_PAGE_BYTES = 1 << 18
"""A configuration page has some 10 kB."""
_PAGE_S = 2.0


class UdpPort:
    """A UDP socket that hears one address alone. It is read when it is polled: the kernel keeps the rest."""

    def __init__(
        self,
        name: str,
        address: str,
        port: int,
        received: BytesHandler,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """`name` is what a person calls the link, as below `links`."""
        self._name, self._address, self._port = name, address, port
        self._received, self._now = received, now
        self._socket: socket.socket | None = None
        self.place = address
        self.lost = False
        self.trouble = ""

    def open(self) -> None:
        """Make the socket. Raises RigFault in one sentence."""
        self._release()
        try:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
            self._socket.connect((self._address, self._port))
        except OSError as error:
            self._release()
            raise RigFault(
                f"{self._name.capitalize()} link ({self.place}): {network_reason(error)};"
                f" see links.{self._name} in the rig file"
            ) from error
        self._socket.setblocking(False)
        self.lost = False

    def poll(self) -> None:
        """Take what has arrived."""
        if self._socket is None:
            return
        for _ in range(_READ_AT_MOST):
            try:
                data = self._socket.recv(_DATAGRAM_BYTES)
            except OSError:  # nothing there, or nobody listens there
                return
            self._received(data, self._now())

    def send(self, data: bytes) -> bool:
        """Send one datagram; False when the network refuses it."""
        if self._socket is None:
            return False
        with contextlib.suppress(OSError):
            return self._socket.send(data) == len(data)
        return False

    async def close(self) -> None:
        """Release the port; safe to call twice."""
        self._release()

    def _release(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def fetch_page(address: str, port: int, path: str) -> bytes:
    """What http://address:port/path serves. Blocks, for seconds at most. Raises RigFault in one sentence."""
    url = f"http://{address}:{port}/{path}"
    connection = http.client.HTTPConnection(address, port, timeout=_PAGE_S)
    try:
        connection.request("GET", f"/{path}")
        with connection.getresponse() as answer:
            content = answer.read(_PAGE_BYTES + 1)
    except OSError as error:
        raise RigFault(f"{url}: no page: {network_reason(error)}") from error
    except (http.client.HTTPException, ValueError) as error:
        told = " ".join(str(error).split()) or type(error).__name__
        raise RigFault(f"{url}: no page: {told}; is this the sensor's address?") from error
    finally:
        connection.close()
    if answer.status != http.HTTPStatus.OK:
        raise RigFault(f"{url}: answers {answer.status} {answer.reason}; is this the sensor's address?")
    if len(content) > _PAGE_BYTES:
        raise RigFault(f"{url}: longer than {_PAGE_BYTES >> 10} kB; is this the sensor's address?")
    return content
