"""Ports as people meet them: claimed for one process, and refused in one sentence."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path


def claim(path: str) -> int:
    """Hold `path` for this process alone, before a byte is sent that would disturb its owner."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise OSError(error.errno, error.strerror, path) from error
    return descriptor


def port_reason(error: OSError, path: str) -> str:
    """Why a port cannot be opened, and what to do, for a person."""
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        folder = Path(path).parent
        return f"there is no {path}; is the adapter plugged in? ls {folder} shows what is there"
    if error.errno in (errno.EWOULDBLOCK, errno.EBUSY):
        return f"{path} is in use by another program, such as another needle-rig; stop that one first"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"no right to open {path}; add this user to its group (often dialout) and log in again"
    if error.errno is None or error.errno == errno.ENOTTY:
        return f"{path} is no serial port"
    return f"cannot open {path}: {os.strerror(error.errno)}"
