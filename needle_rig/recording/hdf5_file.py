"""Looks into a run's HDF5 file so that no byte of it can hold up or end the program.

A file is never opened in HDF5's mode for reading beside a writer, which files of older versions may ask for:
on a damaged head that mode retries for ever. Instead the library is shown the superblock of a closed file of
the true length. A run that goes on is read from its journal.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import h5py

from needle_rig.config.regular_file import open_regular
from needle_rig.errors import BadInput
from needle_rig.recording.global_heap import check_heaps
from needle_rig.recording.image import journal_as_hdf5
from needle_rig.recording.structure import check_plain, check_structure
from needle_rig.recording.superblock import SIGNATURE, SUPERBLOCK_BYTES, Superblock
from needle_rig.recording.tables import judge_run

LIMIT_BYTES = 1_000_000_000
"""Seven hours of a run; tables are read whole, and exporting one takes several times its size in memory."""

Found = TypeVar("Found")


def read_hdf5(path: str | os.PathLike[str], shown: str, take: Callable[[h5py.File], Found]) -> Found:
    """What `take` finds in the HDF5 file at `path`, which `shown` names in errors.

    Raises BadInput for whatever is wrong with the file: nothing of it is open afterwards.
    """
    missing = "; list the runs with: needle-rig runs"
    with open_regular(path, shown, LIMIT_BYTES, missing=lambda: missing) as stream:
        content = _Content(stream, shown)
        return _look(lambda: h5py.File(content, "r"), content.size_bytes, shown, take)


def read_journal(path: Path, shown: str, take: Callable[[h5py.File], Found]) -> Found:
    """What `take` finds in the journal at `path` up to its last whole frame, as in the file made of it.

    Raises BadInput for whatever is wrong with it, and FileNotFoundError.
    """
    return _look(lambda: journal_as_hdf5(path), path.stat().st_size, shown, take)


def _look(
    open_file: Callable[[], h5py.File], size_bytes: int, shown: str, take: Callable[[h5py.File], Found]
) -> Found:
    try:
        with open_file() as file:
            check_plain(file, size_bytes)
            # first: a newer format may have other tables
            judge_run({name: file.attrs.get(name) for name in ("format", "versions")}, shown)
            check_structure(file, size_bytes)
            return take(file)
    except (BadInput, FileNotFoundError):
        raise
    except Exception as error:  # noqa: BLE001 whatever h5py makes of damaged bytes, MemoryError included
        raise BadInput(
            f"{shown}: is no readable run: {_first_line(error)}; copy it again if you can"
        ) from None


class _Content:
    """The bytes of a file as h5py's driver for Python files asks for them."""

    def __init__(self, stream: BinaryIO, shown: str) -> None:
        self._descriptor = stream.fileno()
        self.size_bytes = os.fstat(self._descriptor).st_size
        self._at = 0
        if self.size_bytes == 0:
            raise BadInput(f"{shown}: is empty: it was cut off before it began")
        head = os.pread(self._descriptor, SUPERBLOCK_BYTES, 0)
        superblock = Superblock.parse(head)
        if superblock is None:
            raise BadInput(f"{shown}: {_what_is_wrong_with(head)}")
        if superblock.end_bytes > self.size_bytes:
            raise BadInput(
                f"{shown}: lost its end on the way: it has {self.size_bytes} of {superblock.end_bytes} bytes;"
                " copy it again from where it was recorded"
            )
        self._head = superblock.closed(self.size_bytes)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self.size_bytes}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def read(self, size: int) -> bytes:
        content = bytearray(size)
        self.readinto(content)
        return bytes(content)

    def readinto(self, buffer: Any) -> int:
        wanted = memoryview(buffer).cast("B")
        got = os.preadv(self._descriptor, [wanted], self._at)
        if got < len(wanted):
            raise OSError(f"byte {self._at + len(wanted)} was asked for in a file of {self.size_bytes}")
        check_heaps(self._descriptor, self._at, got)
        head = self._head[self._at : self._at + got]
        wanted[: len(head)] = head
        self._at += got
        return got


def _what_is_wrong_with(head: bytes) -> str:
    if not head.startswith(SIGNATURE):
        return "is not a readable run (it does not begin as HDF5 files do)"
    if len(head) > len(SIGNATURE) and head[len(SIGNATURE)] in (0, 1):
        return "is HDF5 but no run of needle-rig (its superblock is of an older version)"
    return "is damaged in its first 48 bytes (the checksum of its superblock does not hold); copy it again"


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines()
    return (lines[0] if lines else type(error).__name__)[:200]
