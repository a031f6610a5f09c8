"""JSON: arrays by name, or a list of samples; one sample a line is a data frame."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.importing.arrays import Leaf, columns_of
from needle_rig.importing.data_frame import read_frame
from needle_rig.importing.matlab import flatten
from needle_rig.importing.recording import LIMIT_BYTES, Read

MOST_BYTES = LIMIT_BYTES // 10
"""A document is in memory as objects, ten times as large; lines are read as a frame."""


def may_be_json(head: bytes) -> bool:
    """Whether a file that begins so may be JSON; a text with columns hardly begins with a bracket."""
    return head.lstrip()[:1] in (b"{", b"[") and head.lstrip()[1:].lstrip()[:1] in b'"[{-0123456789'


def read_json(path: Path, shown: str) -> Read:
    """Dialect in words, columns and rates. Raises BadInput."""
    with path.open("rb") as file:
        first, second = file.readline(1 << 20), file.readline(1 << 10).strip()
    if first.lstrip().startswith(b"{") and second.startswith(b"{") and _is_whole(first):
        return read_frame(path, shown)
    if path.stat().st_size > MOST_BYTES:
        raise BadInput(
            f"{shown}: larger than {MOST_BYTES / 1e6:g} MB; write one sample a line (JSON lines) or Parquet"
        )
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{shown}: cannot be read as JSON: {str(error)[:200]}; write it again") from None
    leaves: dict[str, Leaf] = {}
    flatten(_as_arrays(content), "", leaves)
    columns, rates = columns_of(leaves, shown)
    return "JSON", columns, rates


def _is_whole(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line), dict)
    except ValueError:
        return False


def _as_arrays(node: Any) -> Any:
    """Lists of numbers as arrays, lists of samples as an array for each of their names."""
    if isinstance(node, dict):
        return {str(key): _as_arrays(value) for key, value in node.items()}
    if not isinstance(node, list) or not node:
        return node
    if all(isinstance(item, dict) for item in node):
        names = dict.fromkeys(key for item in node for key in item)
        return {str(name): _as_arrays([item.get(name) for item in node]) for name in names}
    if all(item is None or isinstance(item, int | float) for item in node):
        return np.array([np.nan if item is None else item for item in node], dtype=np.float64)
    try:
        return np.array(node, dtype=np.float64)
    except (ValueError, TypeError):
        return node
