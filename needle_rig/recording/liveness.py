"""Whether a run is still being written: its writer holds a lock on the journal."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from needle_rig.recording.journal import journal_path


def being_written(path: str | os.PathLike[str]) -> bool:
    """Whether a process that lives is writing the run file at `path`; False when there is none."""
    try:
        descriptor = os.open(journal_path(Path(path)), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError):
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    finally:
        os.close(descriptor)
    return False
