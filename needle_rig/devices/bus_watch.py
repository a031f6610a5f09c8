"""Listens to a CAN interface beside whoever uses it: which frames come, and how much of the bus they take."""

from __future__ import annotations

import socket
import struct
import time
from collections import Counter

from needle_rig.errors import RigFault

_FRAME = struct.Struct("=IB3x8s")
_EXTENDED = 0x8000_0000
_RECEIVE_BYTES = 4 << 20


def frame_bits(data_bytes: int, *, extended: bool = False) -> int:
    """Most bits that a classic frame takes on the wire, stuff bits and the gap after it included.

    Of ISO 11898-1, as Davis et al., Real-Time Systems 35 (2007), eq. 1: every fifth bit of the stuffed part
    may be a stuff bit.
    """
    stuffed = (54 if extended else 34) + 8 * data_bytes
    return stuffed + (stuffed - 1) // 4 + 13


def watch_bus(interface: str, seconds_s: float) -> tuple[Counter[int], int]:
    """Frames by id, and all their bits at most, of `interface` in the next `seconds_s`.

    Blocks. Raises RigFault where the interface cannot be listened to.
    """
    frames: Counter[int] = Counter()
    bits = 0
    try:
        with socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
            bus.bind((interface,))
            end_s = time.monotonic() + seconds_s
            while (left_s := end_s - time.monotonic()) > 0:
                bus.settimeout(left_s)
                try:
                    frame_id, length, _ = _FRAME.unpack(bus.recv(_FRAME.size))
                except TimeoutError:
                    break
                frames[frame_id & 0x1FFF_FFFF] += 1
                bits += frame_bits(length, extended=bool(frame_id & _EXTENDED))
    except OSError as error:
        raise RigFault(
            f"{interface}: cannot be listened to: {error.strerror}; see: needle-rig check"
        ) from None
    return frames, bits
