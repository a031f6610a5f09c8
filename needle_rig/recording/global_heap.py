"""Global heaps of an HDF5 file, which hold its texts: the one kind of metadata without a checksum.

HDF5 file format specification 3.0, section III.E. libhdf5 walks a heap's objects by their sizes and never
ends on one whose size leads it nowhere; so they are walked here first.
"""

from __future__ import annotations

import os
import struct

BEGINNING = b"GCOL\x01"
_HEADER = struct.Struct("<4sB3xQ")
_OBJECT = struct.Struct("<HH4xQ")


def check_heaps(descriptor: int, at: int, size_bytes: int) -> None:
    """Raise OSError for a damaged heap whose beginning touches the `size_bytes` from `at` on."""
    first = max(0, at - len(BEGINNING) + 1)
    content = os.pread(descriptor, at - first + size_bytes + len(BEGINNING) - 1, first)
    found = content.find(BEGINNING)
    while found >= 0:
        _check_heap(descriptor, first + found)
        found = content.find(BEGINNING, found + 1)


def _check_heap(descriptor: int, address: int) -> None:
    header = os.pread(descriptor, _HEADER.size, address)
    size_bytes = _HEADER.unpack(header)[2] if len(header) == _HEADER.size else 0
    if address + size_bytes > os.fstat(descriptor).st_size or size_bytes < _HEADER.size:
        raise OSError(f"the texts at byte {address} are damaged: they claim {size_bytes} bytes")
    heap = os.pread(descriptor, size_bytes, address)
    at = _HEADER.size
    while len(heap) - at >= _OBJECT.size:
        index, _, length = _OBJECT.unpack_from(heap, at)
        # object 0 is the free space, whose length has its own head in it
        step = _OBJECT.size + (length + 7) // 8 * 8 if index else length
        if not _OBJECT.size <= step <= len(heap) - at:
            raise OSError(f"the texts at byte {address + at} are damaged")
        at += step
