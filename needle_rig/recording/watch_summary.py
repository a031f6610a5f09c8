"""Where the watch over runs keeps what it found, beside them, and what it said last."""

from __future__ import annotations

import json
from pathlib import Path

from needle_rig.records import JsonObject

WATCH_FOLDER = ".watch"
"""A file a run, named as it; written by `workbench.learning.watch`."""
SUMMARY = "summary.json"
LARGEST_BYTES = 1_000_000


def read_summary(directory: Path) -> list[str]:
    """What was said last of the runs in `directory`; nothing where they are not watched."""
    sentences = _summary(directory).get("sentences")
    return [str(sentence) for sentence in sentences] if isinstance(sentences, list) else []


def read_contradiction(directory: Path) -> str:
    """What the newest run says against the model of the rig file; empty where it says nothing."""
    return str(_summary(directory).get("contradiction", ""))


def _summary(directory: Path) -> JsonObject:
    try:
        with (directory / WATCH_FOLDER / SUMMARY).open("rb") as file:
            told = json.loads(file.read(LARGEST_BYTES))
    except (OSError, ValueError):
        return {}
    return told if isinstance(told, dict) else {}
