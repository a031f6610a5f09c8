"""What a result is of: hashes of data and model, so that no result stands under another's name."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from needle_rig.model import effect_directories
from needle_rig.recording import journal_path
from needle_rig.version import VERSION

_BLOCK_BYTES = 1 << 20
_known: dict[tuple[str, int, int], bytes] = {}
"""By path, time of change and size: a file is read once."""


def data_hash(paths: Sequence[str]) -> str:
    """Of the content of all files of these datasets and runs; their places do not count."""
    whole = hashlib.sha256()
    for text in paths:
        path = Path(text)
        if not path.exists():  # a run that is being written
            path = journal_path(path)
        for file in _files(path):
            name = file.relative_to(path).as_posix() if file != path else path.suffix
            whole.update(hashlib.sha256(name.encode()).digest() + file_hash(file))
    return whole.hexdigest() if paths else ""


def model_hash(model: str | None, effects: Iterable[str]) -> str:
    """Of a model file, or of the name of a parameter set, and of all effects that can be used."""
    whole = hashlib.sha256(VERSION.encode())
    if model is not None:
        path = Path(model)
        whole.update(file_hash(path) if path.is_file() else model.encode())
    for folder in effect_directories(tuple(effects)):
        for file in sorted(Path(folder).glob("*.py")):
            whole.update(file.name.encode() + file_hash(file))
    return whole.hexdigest()


def question_text(kind: str, question: dict[str, Any]) -> str:
    """What was asked of them, as one text that is the same for the same question."""
    return json.dumps([kind, question], sort_keys=True)


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    return sorted(file for file in path.rglob("*") if file.is_file() and not file.name.startswith("."))


def file_hash(path: Path) -> bytes:
    """SHA-256 of a file's content."""
    state = path.stat()
    key = (str(path), state.st_mtime_ns, state.st_size)
    if key not in _known:
        whole = hashlib.sha256()
        with path.open("rb") as file:
            while block := file.read(_BLOCK_BYTES):
                whole.update(block)
        _known[key] = whole.digest()
    return _known[key]
