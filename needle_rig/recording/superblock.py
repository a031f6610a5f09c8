"""The superblock at the start of an HDF5 file: what it claims, and a closed file's in its place.

HDF5 file format specification 3.0, section II.A, versions 2 and 3 with 8-byte addresses:
https://support.hdfgroup.org/documentation/hdf5/latest/_f_m_t3.html
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Self

SIGNATURE = b"\x89HDF\r\n\x1a\n"
SUPERBLOCK_BYTES = 48
_FIELDS = struct.Struct("<8sBBBBQQQQ")
_CHECKSUM = struct.Struct("<I")
_MASK = 0xFFFFFFFF


@dataclass(frozen=True)
class Superblock:
    """What a superblock of version 2 or 3 says."""

    version: int
    flags: int
    base_address: int
    extension_address: int
    end_bytes: int
    root_address: int

    @classmethod
    def parse(cls, head: bytes) -> Self | None:
        """The superblock in the first bytes of a file, or None when its own checksum does not hold."""
        if len(head) < SUPERBLOCK_BYTES:
            return None
        signature, version, offset_bytes, length_bytes, flags, *addresses = _FIELDS.unpack_from(head)
        (checksum,) = _CHECKSUM.unpack_from(head, _FIELDS.size)
        if signature != SIGNATURE or version not in (2, 3) or (offset_bytes, length_bytes) != (8, 8):
            return None
        return cls(version, flags, *addresses) if checksum == lookup3(head[: _FIELDS.size]) else None

    @property
    def marked_open(self) -> bool:
        """Whether a writer marked the file as open; a killed one leaves the mark."""
        return self.flags != 0

    def closed(self, end_bytes: int) -> bytes:
        """The superblock as a writer would leave it that closes a file of `end_bytes`."""
        content = _FIELDS.pack(
            SIGNATURE,
            self.version,
            8,
            8,
            0,
            self.base_address,
            self.extension_address,
            end_bytes,
            self.root_address,
        )
        return content + _CHECKSUM.pack(lookup3(content))


def lookup3(data: bytes) -> int:
    """Bob Jenkins's hash of 2006 (`hashlittle`, initial value 0), the checksum of HDF5's metadata."""
    a = b = c = (0xDEADBEEF + len(data)) & _MASK
    last = max(0, (len(data) - 1) // 12 * 12)
    x: int
    y: int
    z: int
    for at in range(0, last, 12):
        x, y, z = struct.unpack_from("<III", data, at)
        a, b, c = (a + x) & _MASK, (b + y) & _MASK, (c + z) & _MASK
        a = ((a - c) & _MASK) ^ _turned(c, 4)
        c = (c + b) & _MASK
        b = ((b - a) & _MASK) ^ _turned(a, 6)
        a = (a + c) & _MASK
        c = ((c - b) & _MASK) ^ _turned(b, 8)
        b = (b + a) & _MASK
        a = ((a - c) & _MASK) ^ _turned(c, 16)
        c = (c + b) & _MASK
        b = ((b - a) & _MASK) ^ _turned(a, 19)
        a = (a + c) & _MASK
        c = ((c - b) & _MASK) ^ _turned(b, 4)
        b = (b + a) & _MASK
    if not data:
        return c
    x, y, z = struct.unpack("<III", data[last:].ljust(12, b"\0"))
    a, b, c = (a + x) & _MASK, (b + y) & _MASK, (c + z) & _MASK
    c = ((c ^ b) - _turned(b, 14)) & _MASK
    a = ((a ^ c) - _turned(c, 11)) & _MASK
    b = ((b ^ a) - _turned(a, 25)) & _MASK
    c = ((c ^ b) - _turned(b, 16)) & _MASK
    a = ((a ^ c) - _turned(c, 4)) & _MASK
    b = ((b ^ a) - _turned(a, 14)) & _MASK
    return ((c ^ b) - _turned(b, 24)) & _MASK


def _turned(word: int, bits: int) -> int:
    return ((word << bits) | (word >> (32 - bits))) & _MASK
