"""The journal of a run that goes on: its rows in frames that show by their checksum whether they are whole.

`NAME.journal` begins with a magic and random bytes. The first frame holds the run file as it is before the
first row (an HDF5 image with all tables and attributes), every other one rows of one table. The CRC-32 of a
frame goes on from that of the frame before it, the first from the random bytes: what is torn, of another run,
repeated or in another order does not fit. Zeros after the last frame are room kept for the run's last words.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput, RigFault

SUFFIX = ".journal"
MAGIC = b"NRJRNL1\n"
HEAD_BYTES = 16
FRAME = struct.Struct("<IHI")
"""Length of the payload in bytes, number of the table, CRC-32 of both and the payload."""

RESERVE_BYTES = 65_536
"""Room kept beyond the rows: a full disk is met while the result and hundreds of events still fit."""

_LOCK_TRIES = 40
_LOCK_PAUSE_S = 0.05
_BLOCK_BYTES = 2**20
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def journal_path(run: Path) -> Path:
    """Where the journal of the run file `run` lies while it goes on."""
    return run.parent / (run.stem + SUFFIX)


def sync_folder(folder: Path) -> None:
    """Wait until the names in `folder` are on the disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_full(error: OSError) -> bool:
    """Whether the disk refused for want of room."""
    return error.errno in _FULL


def refusal(error: OSError) -> str:
    """Why the disk refused, in words for a person and without addresses."""
    return os.strerror(error.errno) if error.errno else "the disk refused"


class Frames:
    """Reads the whole frames of the journal at `path` in order, as table number and payload.

    `end_bytes` and `checksum` say how far it came. Raises BadInput when the file is no journal; a journal
    whose first frame is not whole yields none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.end_bytes = HEAD_BYTES
        self.checksum = 0
        self.torn_bytes = 0
        """What stands after the last whole frame and is not zero; known once all frames were read."""

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        self.end_bytes, self.torn_bytes = HEAD_BYTES, 0
        with self.path.open("rb") as stream:
            size_bytes = os.fstat(stream.fileno()).st_size
            head = stream.read(HEAD_BYTES)
            if head.strip(b"\0") and head[: len(MAGIC)] != MAGIC[: len(head)]:
                raise BadInput(f"{show_path(self.path)}: is no journal of a run")
            self.checksum = zlib.crc32(head)
            while True:
                before = stream.read(FRAME.size)
                length, table, checksum = FRAME.unpack(before) if len(before) == FRAME.size else (0, 0, 0)
                if not 0 < length <= size_bytes - self.end_bytes - FRAME.size:
                    break
                payload = stream.read(length)
                if _checksum(length, table, payload, self.checksum) != checksum:
                    break
                self.checksum = checksum
                self.end_bytes += FRAME.size + length
                yield table, payload
            stream.seek(min(self.end_bytes, size_bytes))
            begin_bytes = stream.tell()
            while block := stream.read(_BLOCK_BYTES):
                if used := len(block.rstrip(b"\0")):
                    self.torn_bytes = begin_bytes + used - self.end_bytes
                begin_bytes += len(block)


class Journal:
    """A journal that this process writes and holds the lock of; another thread may call `sync`."""

    def __init__(self, path: Path, descriptor: int, end_bytes: int, checksum: int) -> None:
        self.path = path
        self.torn_bytes = 0
        """What the process before left of a frame; it is wiped."""
        self._descriptor = descriptor
        self._end_bytes = self._allocated_bytes = end_bytes
        self._checksum = checksum

    @property
    def is_open(self) -> bool:
        """Whether it can still be written."""
        return self._descriptor >= 0

    @classmethod
    def create(cls, path: Path, image: bytes) -> Self:
        """Begin the journal at `path` with the HDF5 `image`; on the disk, name and all, when this returns.

        Raises FileExistsError and other OSError.
        """
        while True:
            descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_CLOEXEC, 0o644)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            if _is_at(descriptor, path):
                break
            os.close(descriptor)  # it was taken for an abandoned one before it was locked
        head = MAGIC + os.urandom(HEAD_BYTES - len(MAGIC))
        journal = cls(path, descriptor, 0, 0)
        try:
            journal._write(head, RESERVE_BYTES)
            journal._checksum = zlib.crc32(head)
            journal.append(0, image)
            os.fsync(descriptor)
            sync_folder(path.parent)
        except BaseException:
            journal.remove()
            raise
        return journal

    @classmethod
    def reopen(cls, path: Path, take: Callable[[int, bytes], object]) -> Self:
        """Take over the journal that another process left at `path`: `take` its frames, wipe a torn end.

        Raises BadInput while another process writes it and when it is no journal, and OSError.
        """
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            _lock(descriptor, path)
            if not _is_at(descriptor, path):
                raise FileNotFoundError(errno.ENOENT, "")
            frames = Frames(path)
            for table, payload in frames:
                take(table, payload)
            if frames.torn_bytes:
                os.pwrite(descriptor, bytes(frames.torn_bytes), frames.end_bytes)
        except BaseException:
            os.close(descriptor)
            raise
        journal = cls(path, descriptor, frames.end_bytes, frames.checksum)
        # the room that was kept for the last words still is
        journal._allocated_bytes = max(os.fstat(descriptor).st_size, frames.end_bytes)
        journal.torn_bytes = frames.torn_bytes
        return journal

    def append(self, table: int, payload: bytes, *, last_words: bool = False) -> None:
        """Add a frame; with the kernel when this returns. `last_words` may use the room kept for them.

        Raises OSError, and has added nothing then.
        """
        checksum = _checksum(len(payload), table, payload, self._checksum)
        raw = FRAME.pack(len(payload), table, checksum) + payload
        self._write(raw, 0 if last_words else RESERVE_BYTES)
        self._checksum = checksum

    def sync(self) -> None:
        """Wait until all frames are on the disk. Raises OSError, and RigFault when it was taken away."""
        os.fdatasync(self._descriptor)
        if not _is_at(self._descriptor, self.path):
            raise RigFault(
                f"{show_path(self.path)}: was deleted or moved while the run was written to it;"
                " leave the folder of the runs alone until the run has ended"
            )

    def close(self) -> None:
        """Give the lock back; the journal stays. Safe to call twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def remove(self) -> None:
        """Delete the journal, if it is still in its place."""
        if self.is_open and _is_at(self._descriptor, self.path):
            self.path.unlink()
        self.close()

    def _write(self, raw: bytes, spare_bytes: int) -> None:
        needed_bytes = self._end_bytes + len(raw) + spare_bytes
        if needed_bytes > self._allocated_bytes:
            # room first: what is written then cannot be cut off by a full disk
            try:
                until_bytes = -(-needed_bytes // RESERVE_BYTES) * RESERVE_BYTES
                os.posix_fallocate(
                    self._descriptor, self._allocated_bytes, until_bytes - self._allocated_bytes
                )
                self._allocated_bytes = until_bytes
            except OSError as error:
                if is_full(error) or error.errno == errno.EIO:
                    raise
                # a file system that cannot keep room: the write itself is judged
        begin_bytes = self._end_bytes
        while raw:
            written = os.pwrite(self._descriptor, raw, begin_bytes)
            raw, begin_bytes = raw[written:], begin_bytes + written
        self._end_bytes = begin_bytes


def _checksum(length: int, table: int, payload: bytes, before: int) -> int:
    return zlib.crc32(payload, zlib.crc32(FRAME.pack(length, table, 0), before))


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _lock(descriptor: int, path: Path) -> None:
    for _ in range(_LOCK_TRIES):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:  # one who looks whether it is being written holds it for a moment
            time.sleep(_LOCK_PAUSE_S)
    raise BadInput(f"{show_path(path)}: is being written by another process; wait until it has ended")
