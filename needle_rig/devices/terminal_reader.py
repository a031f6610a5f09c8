"""Reads a terminal in a thread of its own, so that the tick never waits for it.

Who reads a terminal, or merely polls it, waits until the kernel's worker has passed on what came. The worker
has ordinary priority: beside busy programs that takes milliseconds, whatever the priority of who waits.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable

from needle_rig.devices.device import BytesHandler

_READ_BYTES = 65536
_ENDED = select.POLLHUP | select.POLLERR | select.POLLNVAL
_CLOSE_S = 1.0


class TerminalReader:
    """What comes at the descriptor `terminal` goes to `received` with the time of its reading.

    Both handlers are called by the running loop, or by `drain`; `ended` once, with why nothing comes any
    more. The thread has the scheduling of who makes it, one priority below.
    """

    def __init__(
        self,
        terminal: int,
        received: BytesHandler,
        ended: Callable[[OSError], None],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._terminal, self._received, self._on_end, self._now = terminal, received, ended, now
        self._chunks: deque[tuple[bytes, float]] = deque()
        self._end: OSError | None = None
        self._told = False
        self._loop = asyncio.get_running_loop()
        self._came = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._enough = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._loop.add_reader(self._came, self.drain)
        policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        priority = os.sched_getparam(0).sched_priority
        self._thread = threading.Thread(
            target=self._read, args=(policy, priority), name="terminal", daemon=True
        )
        self._thread.start()

    def drain(self) -> None:
        """Hand on what was read so far."""
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._came)
        while self._chunks:
            self._received(*self._chunks.popleft())
        if self._end is not None and not self._told:
            self._told = True
            self._on_end(self._end)

    def close(self) -> None:
        """Stop reading; the terminal stays open. Safe to call twice."""
        if self._came < 0:
            return
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
        while True:
            events = dict(poller.poll())
            if self._enough in events:
                return
            try:
                data = os.read(self._terminal, _READ_BYTES)
            except BlockingIOError:
                data = b""
            except OSError as error:
                self._finish(error)
                return
            if data:
                self._chunks.append((data, self._now()))
                os.eventfd_write(self._came, 1)
            elif events[self._terminal] & _ENDED:
                self._finish(OSError(errno.EIO, os.strerror(errno.EIO)))
                return

    def _finish(self, error: OSError) -> None:
        self._end = error
        os.eventfd_write(self._came, 1)
