"""When the tick comes: a kernel timer with absolute deadlines, or virtual time."""

from __future__ import annotations

import asyncio
import ctypes
import os
import struct
import sys
import time
from collections.abc import Callable
from typing import Protocol

_CLOEXEC_NONBLOCK = os.O_CLOEXEC | os.O_NONBLOCK
_ABSOLUTE = 1
_YIELD_EVERY_S = 0.002


class Clock(Protocol):
    """Gives the time in seconds and paces the ticks."""

    period_s: float
    lateness_s: float
    """How late the newest tick woke up."""

    def now_s(self) -> float:
        """The time since an arbitrary origin; never goes back."""

    async def tick(self, busy: bool) -> int:
        """Wait for the next tick and return how many were skipped since the last one.

        Time may stand still while not `busy`: then `now_s` is what it was at the last tick.
        """

    def overrun(self) -> bool:
        """Whether the deadline of the present tick (the start of the next one) has passed already."""

    def close(self) -> None:
        """Release the timer."""


class TimerClock:
    """Ticks of a Linux timerfd on the monotonic clock, at absolute times start + n · period.

    Needs a running asyncio loop.
    """

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.lateness_s = 0.0
        self._period_ns = round(period_s * 1e9)
        self._deadline_ns = time.monotonic_ns() + self._period_ns
        self._fd = _timerfd(self._deadline_ns, self._period_ns)
        self._loop = asyncio.get_running_loop()
        self._waiting: asyncio.Future[int] | None = None
        self._expired = 0
        self._loop.add_reader(self._fd, self._on_expiry)

    def now_s(self) -> float:
        """Seconds of the system's monotonic clock."""
        return time.monotonic_ns() * 1e-9

    def _on_expiry(self) -> None:
        try:
            self._expired += struct.unpack("=Q", os.read(self._fd, 8))[0]
        except BlockingIOError:
            return
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(self._expired)

    async def tick(self, busy: bool) -> int:  # noqa: ARG002 see Clock
        """Wait for the timer; see `Clock.tick`. Real time never stands still."""
        if not self._expired:
            self._waiting = self._loop.create_future()
            try:
                await self._waiting
            finally:
                self._waiting = None
        else:
            await asyncio.sleep(0)
        passed, self._expired = self._expired, 0
        self._deadline_ns += passed * self._period_ns
        self.lateness_s = (time.monotonic_ns() - (self._deadline_ns - self._period_ns)) * 1e-9
        return passed - 1

    def overrun(self) -> bool:
        """Whether the next tick should have begun."""
        return time.monotonic_ns() > self._deadline_ns

    def close(self) -> None:
        """Close the timer; safe to call twice."""
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1


class VirtualClock:
    """Time that moves by one period a tick, as fast as ticks are worked off, and rests while nobody is busy.

    `advance` receives each step in seconds: it moves the simulated world.
    """

    lateness_s = 0.0

    def __init__(self, period_s: float, advance: Callable[[float], None]) -> None:
        self.period_s = period_s
        self._advance = advance
        self._ticks = 0
        self._yielded_s = time.monotonic()

    def now_s(self) -> float:
        """Virtual seconds since the start."""
        return self._ticks * self.period_s

    async def tick(self, busy: bool) -> int:
        """Move the world on by one period when `busy`; let others run every few milliseconds."""
        if not busy and self._ticks:
            await asyncio.sleep(self.period_s)
            return 0
        if time.monotonic() - self._yielded_s > _YIELD_EVERY_S:
            await asyncio.sleep(0)
            self._yielded_s = time.monotonic()
        self._advance(self.period_s)
        self._ticks += 1
        return 0

    def overrun(self) -> bool:
        """Virtual time waits for everybody."""
        return False

    def close(self) -> None:
        """Nothing to release."""


def _timerfd(first_ns: int, period_ns: int) -> int:
    """A timer file descriptor whose first expiry is at `first_ns` on the monotonic clock."""
    if sys.version_info >= (3, 13):
        fd: int = os.timerfd_create(time.CLOCK_MONOTONIC, flags=_CLOEXEC_NONBLOCK)
        os.timerfd_settime_ns(fd, flags=_ABSOLUTE, initial=first_ns, interval=period_ns)
        return fd
    libc = ctypes.CDLL(None, use_errno=True)
    fd = int(libc.timerfd_create(time.CLOCK_MONOTONIC, _CLOEXEC_NONBLOCK))
    times = (ctypes.c_long * 4)(*divmod(period_ns, 10**9), *divmod(first_ns, 10**9))
    if fd < 0 or libc.timerfd_settime(fd, _ABSOLUTE, ctypes.byref(times), None) < 0:
        error = ctypes.get_errno()
        raise OSError(error, f"cannot make a timer: {os.strerror(error)}")
    return fd
