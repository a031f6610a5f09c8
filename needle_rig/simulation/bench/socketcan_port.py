"""The bench's CAN port on a SocketCAN interface, as a kernel driver offers an adapter."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
import time
from collections.abc import Callable

from needle_rig.errors import BadInput
from needle_rig.simulation.nodes.slcan_hub import Frame

_FRAME = struct.Struct("=IB3x8s")
_NOT_PLAIN = 0xE000_0000
"""Flags of struct can_frame: extended, remote, error."""
_RETRY_S = 0.5
_READ_AT_MOST = 512


class SocketCanPort:
    """Frames of an interface such as vcan0, which the nodes of the bench and others share.

    An interface that is down or deleted takes nothing; it is bound again when it is back.
    """

    def __init__(self, interface: str) -> None:
        """Raises BadInput when there is no such interface."""
        self.name = interface
        self.lost = 0
        """How many frames found no room, or no interface."""
        self._next_try_s = 0.0
        self._bound = True
        try:
            self._socket = _new_socket()
        except OSError:
            raise BadInput(
                f"--can {interface}: this kernel has no SocketCAN; load it: sudo modprobe can_raw"
            ) from None
        try:
            self._socket.bind((interface,))
        except OSError as error:
            self._socket.close()
            raise BadInput(
                f"--can {interface}: {os.strerror(error.errno or 0).lower()}; make a virtual one with:"
                f" sudo ip link add {interface} type vcan && sudo ip link set {interface} up"
            ) from None

    def fileno(self) -> int:
        """Descriptor to wait on."""
        return self._socket.fileno()

    def receive(self) -> list[Frame]:
        """Plain frames that others sent."""
        frames: list[Frame] = []
        for _ in range(_READ_AT_MOST):
            try:
                frame_id, length, data = _FRAME.unpack(self._socket.recv(_FRAME.size))
            except BlockingIOError:
                break
            except OSError as error:
                self._failed(error)
                break
            if not frame_id & _NOT_PLAIN:
                frames.append((frame_id, data[:length]))
        return frames

    def send(self, frame: Frame) -> None:
        """Give a frame to the interface, at once or not at all."""
        frame_id, data = frame
        try:
            self._socket.send(_FRAME.pack(frame_id, len(data), data))
        except OSError as error:
            self.lost += 1
            self._failed(error)

    def send_garbled(self, frame: Frame, garble: Callable[[bytes], bytes]) -> None:
        """Give a frame with its data garbled to the interface, whose kernel lets no other nonsense pass."""
        self.send((frame[0], garble(frame[1])))

    def flush(self) -> None:
        """Frames are with the kernel already; an interface that went is looked for again."""
        if self._bound or time.monotonic() < self._next_try_s:
            return
        self._next_try_s = time.monotonic() + _RETRY_S
        with contextlib.suppress(OSError):
            self._socket.bind((self.name,))
            self._bound = True

    def close(self) -> None:
        """Leave the bus; safe to call twice."""
        self._socket.close()

    def _failed(self, error: OSError) -> None:
        """A socket of an interface that was deleted stays dead: take another."""
        if self._bound and error.errno in (errno.ENODEV, errno.ENXIO):
            self._socket.close()
            self._socket, self._bound = _new_socket(), False


def _new_socket() -> socket.socket:
    made = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    made.setblocking(False)
    return made
