"""Where slow strategies think: a process of its own, so that no tick waits for a plan."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from needle_rig.control.compensation import think_at_once
from needle_rig.control.strategy import History, Strategy, Task, Waypoint

_PR_SET_PDEATHSIG = 1


class Thinker:
    """Asks quick strategies within the tick and slow ones in a child, which starts when first needed."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    def __call__(self, strategy: Strategy, task: Task, history: History) -> Future[Waypoint | None]:
        """The strategy's next motion, now or later. A child that died is replaced."""
        if not strategy.slow:
            return think_at_once(strategy, task, history)
        try:
            return self._child().submit(strategy.next, task, history)
        except BrokenProcessPool:
            self._pool = None
            return self._child().submit(strategy.next, task, history)

    def close(self) -> None:
        """End the child; an answer still missing will not come. Safe to call twice."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def _child(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                1, mp_context=multiprocessing.get_context("spawn"), initializer=_be_modest
            )
        return self._pool


def _be_modest() -> None:
    """Lower than the tick in every queue, deaf to Ctrl-C, and gone when the daemon is."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    os.nice(5)
