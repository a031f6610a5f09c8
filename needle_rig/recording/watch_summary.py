"""Where the watch over runs keeps what it found, beside them, and what it said last."""

from __future__ import annotations

import json
from pathlib import Path

WATCH_FOLDER = ".watch"
"""A file a run, named as it; written by `workbench.learning.watch`."""
SUMMARY = "summary.json"
LARGEST_BYTES = 1_000_000


def read_summary(directory: Path) -> list[str]:
    """What was said last of the runs in `directory`; nothing where they are not watched."""
    try:
        with (directory / WATCH_FOLDER / SUMMARY).open("rb") as file:
            told = json.loads(file.read(LARGEST_BYTES))
        return [str(sentence) for sentence in told["sentences"]]
    except (OSError, ValueError, LookupError, TypeError):
        return []
