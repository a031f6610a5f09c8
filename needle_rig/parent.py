"""Ends a process with the one that started it: the kernel does, whatever the process is busy with."""

from __future__ import annotations

import fcntl
import os
import select
import signal
from multiprocessing import parent_process


def end_with(descriptor: int) -> None:
    """Have this process killed when anything comes at `descriptor`, or when its other end closes.

    It is the reading end of a pipe or socket whose other end the parent alone holds. A signal at the parent's
    death (prctl) would follow the thread that started this process; a thread that waits here would wait for
    compiled code as well.
    """
    fcntl.fcntl(descriptor, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(descriptor, fcntl.F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(descriptor, fcntl.F_SETFL, fcntl.fcntl(descriptor, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([descriptor], [], [], 0.0)[0]:  # the parent went before the kernel was asked
        os.kill(os.getpid(), signal.SIGKILL)


def end_with_parent() -> None:
    """The same for a process of `multiprocessing`, which has such a pipe."""
    parent = parent_process()
    assert parent is not None
    end_with(parent.sentinel)
