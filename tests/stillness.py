"""A witness of the machine's own pauses: a process on each core that notes how late it woke up.

Run as a program with the number of a core, the seconds between two looks and a real-time priority it is such
a process. It answers each line on standard input with the longest pause since the line before.
"""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import time

CORES_AT_MOST = 4


class Stillness:
    """Watches the cores of this machine until closed."""

    def __init__(self, wake_s: float = 0.005, priority: int = 1) -> None:
        self._watchers = [
            subprocess.Popen(
                [sys.executable, "-S", __file__, str(core), str(wake_s), str(priority)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            for core in sorted(os.sched_getaffinity(0))[:CORES_AT_MOST]
        ]

    def longest_s(self) -> float:
        """The longest pause of any core since the last call."""
        for watcher in self._watchers:
            assert watcher.stdin is not None
            watcher.stdin.write(b"\n")
            watcher.stdin.flush()
        return max(float(watcher.stdout.readline()) for watcher in self._watchers if watcher.stdout)

    def close(self) -> None:
        """End the watchers."""
        for watcher in self._watchers:
            watcher.communicate()


def watch(core: int, wake_s: float, priority: int) -> None:
    """Watch `core` every `wake_s` until standard input ends."""
    os.sched_setaffinity(0, {core})
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    before_s, longest_s = time.monotonic(), 0.0
    while True:
        asked, _, _ = select.select([0], [], [], wake_s)
        now_s = time.monotonic()
        longest_s = max(longest_s, now_s - before_s - wake_s)
        before_s = now_s
        if asked:
            if not os.read(0, 1):
                return
            os.write(1, b"%.6f\n" % longest_s)
            longest_s = 0.0


if __name__ == "__main__":
    watch(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
