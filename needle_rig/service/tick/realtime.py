"""Asks the system for what a steady tick needs; what it refuses becomes a sentence, not an error."""

from __future__ import annotations

import ctypes
import gc
import os

_CURRENT_AND_FUTURE_ONCE_TOUCHED = 7
_PRIORITY = 50


def make_steady() -> list[str]:
    """Real-time priority, locked memory, no garbage collection in the tick. Returns what was refused.

    Call it once everything is imported and built. Children that are started later keep ordinary priority.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    refused = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))
    except OSError as error:
        refused.append(
            f"no real-time priority ({error.strerror}): the tick may come late on a busy machine; "
            "allow it with LimitRTPRIO=50 in the service, or `ulimit -r 50`"
        )
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_CURRENT_AND_FUTURE_ONCE_TOUCHED):
        refused.append(
            f"memory is not locked ({os.strerror(ctypes.get_errno())}): the tick may wait for the disk; "
            "allow it with LimitMEMLOCK=infinity in the service, or `ulimit -l unlimited`"
        )
    return refused
