"""Serial frames of the Hall node: COBS with CRC-16, a counter and the node's own time.

Content, little-endian: type (1), sensor count, counter (16 bit), node time in µs (32 bit), one angle a
sensor in µrad (32 bit signed, within ±π), one field amplitude a sensor (16 bit); then CRC-16/CCITT
(start 0xFFFF) of all that. The whole is COBS-stuffed and closed by 0x00.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

ANGLES_TYPE = 1
COUNTER_MODULUS = 65536
CLOCK_PERIOD_S = 2**32 * 1e-6
HEALTHY_FIELD = (20_000, 60_000)
"""Amplitudes outside mean a magnet lost or a sensor saturated."""

MAX_SENSORS = 9
"""The largest frame that the nodes' buffers hold (64 bytes of content)."""

_HEAD = struct.Struct("<BBHI")
_LARGEST_ANGLE_URAD = math.ceil(math.pi * 1e6)
_LONGEST_FRAME = 255


class HallFrame(NamedTuple):
    """One reading of all sensors: wrapped angles within ±π, field amplitudes 0…65535."""

    counter: int
    node_time_s: float
    angle_rad: tuple[float, ...]
    field: tuple[int, ...]

    @property
    def complaints(self) -> tuple[str, ...]:
        """What is wrong with each sensor's reading; empty where it can be used."""
        lowest, highest = HEALTHY_FIELD
        return tuple(
            [
                ""
                if lowest <= amplitude <= highest
                else f"sees a field of {amplitude}, healthy is {lowest} to {highest}"
                for amplitude in self.field
            ]
        )


def cobs_encode(content: bytes) -> bytes:
    """`content` without zero bytes (Cheshire and Baker 1999), not yet closed by 0x00."""
    out = bytearray()
    for piece in content.split(b"\0"):
        while len(piece) >= 254:
            out += b"\xff" + piece[:254]
            piece = piece[254:]
        out.append(len(piece) + 1)
        out += piece
    return bytes(out)


def cobs_decode(stuffed: bytes) -> bytes | None:
    """The reverse of `cobs_encode`; None when `stuffed` is not a whole COBS frame."""
    if 0 in stuffed:
        return None
    out = bytearray()
    place, end = 0, len(stuffed)
    while place < end:
        code = stuffed[place]
        out += stuffed[place + 1 : place + code]
        place += code
        if code < 255 and place < end:
            out.append(0)
    return bytes(out) if place == end else None


def encode_hall(counter: int, node_time_us: int, angle_rad: Sequence[float], field: Sequence[int]) -> bytes:
    """One frame, closed by 0x00. Angles are wrapped to ±π."""
    count = len(angle_rad)
    if count != len(field) or not 1 <= count <= MAX_SENSORS:
        raise ValueError(f"{count} angles and {len(field)} amplitudes: give 1 to {MAX_SENSORS} of each")
    content = _HEAD.pack(ANGLES_TYPE, count, counter % COUNTER_MODULUS, node_time_us & 0xFFFFFFFF)
    urad = [round(math.remainder(angle, math.tau) * 1e6) for angle in angle_rad]
    content += struct.pack(f"<{count}i{count}H", *urad, *field)
    return cobs_encode(content + struct.pack("<H", binascii.crc_hqx(content, 0xFFFF))) + b"\0"


def decode_hall(stuffed: bytes) -> HallFrame | None:
    """The reading in a frame without its closing 0x00; None when anything about it is wrong."""
    sealed = cobs_decode(stuffed)
    if sealed is None or len(sealed) < _HEAD.size + 2:
        return None
    content = sealed[:-2]
    if binascii.crc_hqx(content, 0xFFFF) != int.from_bytes(sealed[-2:], "little"):
        return None
    kind, count, counter, node_time_us = _HEAD.unpack_from(content)
    if kind != ANGLES_TYPE or not count or len(content) != _HEAD.size + 6 * count:
        return None
    values = struct.unpack_from(f"<{count}i{count}H", content, _HEAD.size)
    urad = values[:count]
    if max(urad) > _LARGEST_ANGLE_URAD or min(urad) < -_LARGEST_ANGLE_URAD:
        return None
    return HallFrame(counter, node_time_us * 1e-6, tuple([angle * 1e-6 for angle in urad]), values[count:])


class HallStream:
    """Finds frames in a stream of bytes, however it is cut and whatever noise is in it."""

    def __init__(self) -> None:
        self._rest = b""
        self.damaged = 0
        """How many pieces between two 0x00 were not a frame."""

    def feed(self, data: bytes) -> Iterator[HallFrame]:
        """The frames that `data` completes, oldest first."""
        *pieces, self._rest = (self._rest + data).split(b"\0")
        # Without a 0x00 for longer than a frame this is noise: keep the tail, which the next 0x00 will judge.
        self._rest = self._rest[-_LONGEST_FRAME - 1 :]
        for piece in pieces:
            frame = decode_hall(piece) if piece else None
            if frame is not None:
                yield frame
            elif piece:
                self.damaged += 1
