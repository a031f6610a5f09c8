"""Starts the watch over the runs: a process of its own, below all others in every queue, and bounded.

The recorder starts it, not the daemon, whose ticks do not even see the fork; nothing waits for it, and it
ends with the recorder.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

LONGEST_S = 300
"""Of one watch, from its start; the solver's first compilation takes a quarter of a minute."""
MOST_BYTES = 4 * 2**30
"""Of address space: a watch over three runs took 0.64 GB at most, without compiling the solver."""
_END_S = 2.0


class WatchProcess:
    """At most one at a time: it looks at every run that is there by its end."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, directory: Path) -> bool:
        """Have the runs in `directory` looked at; False where that goes on already, or cannot be started."""
        if self._process is not None and self._process.poll() is None:
            return False
        try:
            self._process = subprocess.Popen(
                self._command(directory),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                preexec_fn=_be_bounded,  # the recorder has no second thread
            )
        except (OSError, subprocess.SubprocessError):
            return False
        return True

    def end(self) -> None:
        """End it now; what it did not look at the next one looks at."""
        if self._process is None or self._process.poll() is not None:
            return
        # idle priority would keep it from ending on a computer that has work to do
        with suppress(OSError):
            os.sched_setscheduler(self._process.pid, os.SCHED_OTHER, os.sched_param(0))
        self._process.terminate()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _command(self, directory: Path) -> list[str]:
        return [sys.executable, "-m", "needle_rig", "watch", "--dir", str(directory)]


def _be_bounded() -> None:
    """After the fork: idle priority, limits, and an end by SIGALRM, which an exec leaves pending."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    os.nice(19)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST_S, LONGEST_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.alarm(LONGEST_S)
