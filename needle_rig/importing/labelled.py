"""Lines of `label:value`, as a microcontroller prints them for a serial plotter: a column a label."""

from __future__ import annotations

import math
import re
from collections import Counter
from pathlib import Path

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.importing.recording import LIMIT_BYTES, MAX_COLUMNS, Column, Read
from needle_rig.importing.text_rows import NULLS, POINT, STAMP
from needle_rig.importing.unit_text import split_name
from needle_rig.importing.words import words_column

MOST_BYTES = LIMIT_BYTES // 10
"""Lines are in memory as text, beside their numbers."""
FEWEST_LINES = 3
"""So often a label has to come again: a header names each of its keys once."""
_VALUE = (
    rf"{POINT.pattern}|{'|'.join(re.escape(null) for null in sorted(NULLS, key=len, reverse=True) if null)}"
)
_PAIR = re.compile(rf"[ \t,;]*(?P<label>[^\W\d][^:,;\t=]*?)[ \t]*:[ \t]*(?P<value>{_VALUE})(?=[ \t,;]|$)")


def is_labelled(head: bytes) -> bool:
    """Whether most lines of a file that begins so are pairs of a label and a number, and labels repeat."""
    lines = [line for line in _text(head).splitlines()[:-1] if line.strip()]
    found = [pairs for pairs in map(_pairs, lines) if pairs]
    if not found or 2 * len(found) <= len(lines):
        return False
    return min(Counter(label for pairs in found for label in pairs).values()) >= FEWEST_LINES


def read_labelled(path: Path, shown: str) -> Read:
    """Dialect in words, columns and no rates; NaN where a line has no value of a label.

    What comes before the first line with a value, and a last line that is cut off, are left out. Raises
    BadInput with the line.
    """
    if path.stat().st_size > MOST_BYTES:
        raise BadInput(f"{shown}: larger than {MOST_BYTES / 1e6:g} MB; write one row a sample as CSV")
    text = _text(path.read_bytes())
    lines = text.splitlines()
    if text and not text.endswith(("\n", "\r")):
        lines.pop()  # its last number may have lost digits
    rows: list[dict[str, float]] = []
    stamps: list[bytes] = []
    for number, line in enumerate(lines, 1):
        pairs = _pairs(line)
        if pairs:
            rows.append(pairs)
            stamp = STAMP.match(line)
            stamps.append(stamp[1].encode() if stamp else b"")
        elif line.strip() and rows:
            raise BadInput(
                f"{shown}:{number}: {line.strip()[:40]!r} is not label:value as the lines above; correct or"
                " remove it"
            )
    names = list(dict.fromkeys(label for row in rows for label in row))
    if len(names) > MAX_COLUMNS:
        raise BadInput(f"{shown}: {len(names)} labels, more than {MAX_COLUMNS}; keep those of the rig")
    columns = [words_column("recorded at", "", [np.array(stamps)], "utf-8")] if any(stamps) else []
    for name in names:
        values = np.array([row.get(name, math.nan) for row in rows])
        fault = "" if np.isfinite(values).any() else "holds no number"
        columns.append(Column(name, split_name(name)[1], values, fault=fault))
    return "lines of label:value", tuple(columns), {}


def _text(raw: bytes) -> str:
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace")


def _pairs(line: str) -> dict[str, float]:
    """The value of each label of a line; empty unless the whole line is such pairs, each label once."""
    stamp = STAMP.match(line)
    rest, found = line[stamp.end() if stamp else 0 :].rstrip(" \t\r,;"), {}
    while rest:
        pair = _PAIR.match(rest)
        if pair is None or pair["label"] in found:
            return {}
        value = math.nan if pair["value"] in NULLS else float(pair["value"])
        found[pair["label"]] = value
        rest = rest[pair.end() :]
    return found
