"""Reads a terminal in a thread of its own, so that the tick never waits for it.

Who reads a terminal, or merely polls it, waits until the kernel's worker has passed on what came. The worker
has ordinary priority: beside busy programs that takes milliseconds, whatever the priority of who waits.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import math
import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable

from needle_rig.devices.device import BytesHandler

_READ_BYTES = 65536
_LONGEST_PAUSE_S = 0.016
"""A USB adapter hands over as seldom: what judges the times of frames is made for that."""
_BEFORE_TICK = 0.2
"""Of a tick: time to read before it, within which a node sends once at 200 ticks and 1000 frames a second."""
_ENDED = select.POLLHUP | select.POLLERR | select.POLLNVAL
_CLOSE_S = 1.0


class TerminalReader:
    """What comes at the descriptor `terminal` goes to `received` with the time of its reading.

    Both handlers are called by `drain`, and by the running loop where nobody drains; `ended` once, with why
    nothing comes any more. Who drains every `tick_s` finds what came until shortly before: the thread reads
    once a tick, and the loop is left alone. The thread has the scheduling of who makes it, one priority
    below.
    """

    def __init__(
        self,
        terminal: int,
        received: BytesHandler,
        ended: Callable[[OSError], None],
        now: Callable[[], float] = time.monotonic,
        tick_s: float = math.inf,
    ) -> None:
        self._terminal, self._received, self._on_end, self._now = terminal, received, ended, now
        self._tick_s, self._drained_s = tick_s, -math.inf
        self._chunks: deque[tuple[bytes, float]] = deque()
        self._end: OSError | None = None
        self._told = self._closing = False
        self._loop = asyncio.get_running_loop()
        self._came = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._enough = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._loop.add_reader(self._came, self._awoken)
        policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        priority = os.sched_getparam(0).sched_priority
        self._thread = threading.Thread(
            target=self._read, args=(policy, priority), name="terminal", daemon=True
        )
        self._thread.start()

    def drain(self) -> None:
        """Hand on what was read so far."""
        self._drained_s = time.monotonic()
        self._hand_on()

    def _awoken(self) -> None:
        os.eventfd_read(self._came)
        self._hand_on()

    def _hand_on(self) -> None:
        while self._chunks:
            self._received(*self._chunks.popleft())
        if self._end is not None and not self._told:
            self._told = True
            self._on_end(self._end)

    def close(self) -> None:
        """Stop reading; the terminal stays open. Safe to call twice."""
        if self._came < 0:
            return
        self._closing = True
        os.eventfd_write(self._enough, 1)
        self._thread.join(_CLOSE_S)
        self._loop.remove_reader(self._came)
        os.close(self._came)
        if not self._thread.is_alive():  # a thread that hangs in a driver keeps its descriptor
            os.close(self._enough)
        self._came = -1

    def _read(self, policy: int, priority: int) -> None:
        if policy != os.SCHED_OTHER:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, policy, os.sched_param(max(priority - 1, 1)))
        poller = select.poll()
        poller.register(self._terminal, select.POLLIN)
        poller.register(self._enough, select.POLLIN)
        said = 0
        while not self._closing:
            try:
                data = os.read(self._terminal, _READ_BYTES)
            except BlockingIOError:
                data = b""
            except OSError as error:
                self._finish(error)
                return
            if data:
                said = 0
                self._chunks.append((data, self._now()))
                pause_s = self._pause_s()
                if pause_s is None:
                    os.eventfd_write(self._came, 1)
                else:
                    time.sleep(pause_s)
                continue
            if said & _ENDED:
                self._finish(OSError(errno.EIO, os.strerror(errno.EIO)))
                return
            events = dict(poller.poll(_LONGEST_PAUSE_S * 1e3 if self._chunks else None))
            if self._enough in events:
                return
            if not events:  # who drained has ceased to
                os.eventfd_write(self._came, 1)
            said = events.get(self._terminal, 0)

    def _pause_s(self) -> float | None:
        """Until it is time to read for the next tick; None where no tick is to be expected."""
        now_s, tick_s = time.monotonic(), self._tick_s
        since_s = now_s - self._drained_s
        if tick_s > _LONGEST_PAUSE_S or since_s > 2.0 * tick_s:
            return None
        return (-since_s - _BEFORE_TICK * tick_s) % tick_s

    def _finish(self, error: OSError) -> None:
        self._end = error
        os.eventfd_write(self._came, 1)
