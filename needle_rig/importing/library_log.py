"""What a library logs of a damaged file, beside the error that is said of it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_log(library: str) -> Iterator[None]:
    """Nothing of what `library` and its parts log reaches the terminal."""
    logging.getLogger(library)
    # parts may have a level of their own
    logs = [
        log for name, log in logging.root.manager.loggerDict.items() if f"{name}.".startswith(f"{library}.")
    ]
    levels = {log: log.level for log in logs if isinstance(log, logging.Logger)}
    for log in levels:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in levels.items():
            log.setLevel(level)
