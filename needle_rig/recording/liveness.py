"""Whether a run is still being written: its writer holds a lock on the file."""

from __future__ import annotations

import fcntl
import os
import stat
import time

from needle_rig.recording.superblock import SUPERBLOCK_BYTES, Superblock

RECENT_S = 2.0
"""A file that says of itself that it is being written and changed within this time is."""


def being_written(path: str | os.PathLike[str]) -> bool:
    """Whether a process holds the run at `path` open for writing; False when there is none."""
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            return False
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError):
        return False
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        head = Superblock.parse(os.pread(descriptor, SUPERBLOCK_BYTES, 0))
        marked = head is not None and head.marked_open
        return marked and time.time() - os.fstat(descriptor).st_mtime < RECENT_S
    finally:
        os.close(descriptor)
