"""A timer of the Linux kernel in an asyncio loop, at absolute times on the monotonic clock."""

from __future__ import annotations

import asyncio
import ctypes
import functools
import os
import struct
import sys
import time
from collections.abc import Callable

_CLOEXEC_NONBLOCK = os.O_CLOEXEC | os.O_NONBLOCK
_ABSOLUTE = 1


class KernelTimer:
    """Calls `expired` in the running loop with how often it expired since the last call.

    asyncio's own timers are late by up to a millisecond, since epoll counts its time-out in those.
    """

    def __init__(self, expired: Callable[[int], None]) -> None:
        self._expired = expired
        self._fd = _timerfd()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._fd, self._read)

    def set(self, first_ns: int, period_ns: int = 0) -> None:
        """Expire at `first_ns`, then every `period_ns`; once where that is 0."""
        if sys.version_info >= (3, 13):
            os.timerfd_settime_ns(self._fd, flags=_ABSOLUTE, initial=first_ns, interval=period_ns)
            return
        times = (ctypes.c_long * 4)(*divmod(period_ns, 10**9), *divmod(first_ns, 10**9))
        if _libc().timerfd_settime(self._fd, _ABSOLUTE, ctypes.byref(times), None) < 0:
            raise _error("set")

    def close(self) -> None:
        """Release the timer; safe to call twice."""
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    def _read(self) -> None:
        try:
            times = struct.unpack("=Q", os.read(self._fd, 8))[0]
        except BlockingIOError:  # it was set anew meanwhile
            return
        self._expired(times)


def _timerfd() -> int:
    if sys.version_info >= (3, 13):
        fd: int = os.timerfd_create(time.CLOCK_MONOTONIC, flags=_CLOEXEC_NONBLOCK)
        return fd
    fd = int(_libc().timerfd_create(time.CLOCK_MONOTONIC, _CLOEXEC_NONBLOCK))
    if fd < 0:
        raise _error("make")
    return fd


@functools.cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _error(what: str) -> OSError:
    error = ctypes.get_errno()
    return OSError(error, f"cannot {what} a timer: {os.strerror(error)}")
