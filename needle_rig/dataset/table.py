"""CSV files to arrays: any delimiter, decimal comma, byte order marks, UTF-16, long files thinned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from needle_rig.config.regular_file import read_regular
from needle_rig.dataset.csv_rows import BAD, LONG, SHORT, parse_rows, text_changes
from needle_rig.errors import BadInput

Array = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

MAX_SAMPLES = 20_000
"""Rows kept of one file: a model step costs microseconds, a fit takes thousands of passes."""
CHUNK_VALUES = 2_000_000
"""Parsed at a time: 16 MB."""
MAX_COLUMNS = 1000
"""Far above any rig's sensors; the names of columns are compared with each other."""
LIMIT_BYTES = 1_000_000_000
"""Ten million rows of eight columns take 700 MB; the file is held in memory while its rows are thinned."""
UTF16_LIMIT_BYTES = 300_000_000
"""Takes five times its size while it is converted."""


@dataclass(frozen=True)
class Table:
    """Columns of one file. `values` (rows, columns) has NaN where a field is empty; text is apart."""

    columns: tuple[str, ...]
    values: Array
    line: npt.NDArray[np.int64]
    """Line of the file, from 1, of each row."""
    text: npt.NDArray[np.str_]
    """The text column at each row, empty when there is none."""
    notes: tuple[str, ...]


def read_table(path: Path, folder: Path, shown: str, text_column: str, time_stem: str) -> Table:
    """The CSV file at `path`, which must lie in `folder`; `shown` stands for it in messages.

    `text_column` may be absent; every other column must be numbers, and the one whose name starts
    with `time_stem` must not go back.
    Raises BadInput with file and line.
    """
    notes: list[str] = []
    data = _content(path, folder, shown, notes)
    header_line, start, header = _header(data, shown)
    delimiter = max((";", "\t", ","), key=header.count)
    columns = tuple(name.strip().strip('"') for name in header.split(delimiter))
    if delimiter == "," and len(columns) < 2:
        raise BadInput(
            f"{shown}:{header_line}: one column, {header[:60]!r}; separate columns with commas, "
            "semicolons or tabs"
        )
    strange = next((name for name in columns if not name.isprintable()), None)
    if strange is not None:
        raise BadInput(f"{shown}:{header_line}: column {strange!r} has characters that cannot be shown")
    if len(columns) > MAX_COLUMNS:
        raise BadInput(
            f"{shown}:{header_line}: {len(columns)} columns, more than {MAX_COLUMNS}; keep those of the rig"
        )
    twice = [name for name, count in Counter(columns).items() if count > 1]
    if twice:
        raise BadInput(f"{shown}:{header_line}: column {twice[0]} is there twice; keep one")
    if _looks_numeric(columns):
        raise BadInput(f"{shown}:{header_line}: numbers where the names of the columns should be")
    sample = bytes(data[start : start + 65536])
    decimal = "," if delimiter != "," and b"," in sample and b"." not in sample else "."
    if delimiter != ",":
        how = "a decimal comma" if decimal == "," else "a decimal point"
        names = {";": "semicolons", "\t": "tabs"}
        notes.append(f"{shown}:{header_line}: read with {names[delimiter]} between columns and {how}")
    rows = _lines(data[start:])
    every = max(1, -(-rows // MAX_SAMPLES))
    if rows <= MAX_SAMPLES * 1.05:
        every = 1
    text_at = columns.index(text_column) if text_column in columns else -1
    numbers = tuple(c for i, c in enumerate(columns) if i != text_at)
    time_at = next((i for i, c in enumerate(numbers) if c.startswith(time_stem)), -1)
    parts = list(
        _chunks(
            data,
            start,
            header_line,
            columns,
            delimiter,
            decimal,
            text_at,
            every,
            shown,
            notes,
            time_at,
        )
    )
    if not parts:
        raise BadInput(
            f"{shown}:{header_line}: no rows below the header; record again or leave the trial out"
        )
    values = np.concatenate([p[0] for p in parts])
    line = np.concatenate([p[1] for p in parts])
    text = np.concatenate([p[2] for p in parts])
    if every > 1:
        notes.append(f"{shown}: has about {rows:,} rows; every {every}th is used, {len(values):,} in all")
    return Table(numbers, values, line, text, tuple(notes))


def _chunks(
    data: Bytes,
    start: int,
    header_line: int,
    columns: tuple[str, ...],
    delimiter: str,
    decimal: str,
    text_at: int,
    every: int,
    shown: str,
    notes: list[str],
    time_at: int,
) -> Iterator[tuple[Array, npt.NDArray[np.int64], npt.NDArray[np.str_]]]:
    """Chunks of rows, already thinned to every `every`th."""
    numbers = len(columns) - (text_at >= 0)
    # a field takes a byte at least, its separator included
    rows_at_once = min(CHUNK_VALUES, len(data) - start) // len(columns) + 1
    values = np.empty((rows_at_once, numbers))
    line = np.empty(rows_at_once, dtype=np.int64)
    text_start = np.zeros(rows_at_once, dtype=np.int64)
    text_length = np.zeros(rows_at_once, dtype=np.int64)
    at, at_line, seen, last_time = start, header_line + 1, 0, -np.inf
    while at < len(data):
        rows, at, at_line, code, column, field_start, field_end = parse_rows(
            data, at, at_line, len(columns), text_at, ord(delimiter), ord(decimal),
            values, line, text_start, text_length,
        )  # fmt: skip
        if code == SHORT and not np.any(data[at:] == ord("\n")):
            notes.append(f"{shown}:{at_line}: the file ends in the middle of this row; it is left out")
            at = len(data)
        elif code == SHORT:
            raise BadInput(
                f"{shown}:{at_line}: {column} fields where the header has {len(columns)}; "
                "complete or remove the row"
            )
        elif code == LONG:
            raise BadInput(
                f"{shown}:{at_line}: more fields than the header's {len(columns)}; "
                "use another separator when numbers have a decimal comma"
            )
        elif code == BAD:
            found = bytes(data[field_start:field_end]).decode("utf-8", "replace").strip()
            raise BadInput(
                f"{shown}:{at_line}: {columns[column]}: {found[:40]!r} is no number; "
                "correct it, or leave the field empty when the sample is missing"
            )
        if time_at >= 0 and rows:
            last_time = _check_time(values[:rows, time_at], line[:rows], last_time, shown)
        first = -seen % every
        seen += rows
        if first < rows:
            keep = slice(first, rows, every)
            text = _texts(data, text_start[keep], text_length[keep], rows > 0 and text_at >= 0)
            kept_rows = len(range(first, rows, every))
            yield values[keep].copy(), line[keep].copy(), text if text_at >= 0 else np.full(kept_rows, "")


def _check_time(time_s: Array, line: npt.NDArray[np.int64], last_s: float, shown: str) -> float:
    missing = np.flatnonzero(~np.isfinite(time_s))
    if missing.size:
        raise BadInput(f"{shown}:{line[missing[0]]}: the time is missing; fill it in or remove the row")
    before = np.concatenate(([last_s], time_s[:-1]))
    back = np.flatnonzero(time_s < before)
    if back.size:
        i = int(back[0])
        raise BadInput(
            f"{shown}:{line[i]}: time goes back from {before[i]:g} to {time_s[i]:g}; "
            "cut the file there into two trials, or put the rows in order"
        )
    return float(time_s[-1])


def _texts(
    data: Bytes, start: npt.NDArray[np.int64], length: npt.NDArray[np.int64], present: bool
) -> npt.NDArray[np.str_]:
    """The text of each row; equal neighbours are decoded once."""
    if not present:
        return np.full(len(start), "")
    change = text_changes(data, start, length)
    runs = np.flatnonzero(change)
    words = [
        bytes(data[start[i] : start[i] + length[i]]).decode("utf-8", "replace").strip().strip('"')
        for i in runs
    ]
    counts = np.diff(np.append(runs, len(start)))
    return np.repeat(np.array(words, dtype=np.str_), counts)


def _header(data: Bytes, shown: str) -> tuple[int, int, str]:
    """Line of the header, where the rows start, and the header's text."""
    start, line = 0, 0
    while start < len(data):
        block = bytes(data[start : start + 65536])
        end = block.find(b"\n")
        text = (block if end < 0 else block[:end]).decode("utf-8", "replace").strip("\ufeff \r")
        line += 1
        after = len(data) if end < 0 else start + end + 1
        if text and not text.startswith("#"):
            return line, after, text
        start = after
    raise BadInput(f"{shown}:1: the file is empty; record again or take it out of dataset.yaml")


def _lines(data: Bytes) -> int:
    blocks = range(0, len(data), CHUNK_VALUES)
    return sum(int(np.count_nonzero(data[at : at + CHUNK_VALUES] == ord("\n"))) for at in blocks)


def _looks_numeric(columns: tuple[str, ...]) -> bool:
    try:
        return all(np.isfinite(float(c.replace(",", "."))) for c in columns if c)
    except ValueError:
        return False


def _content(path: Path, folder: Path, shown: str, notes: list[str]) -> Bytes:
    """The file's bytes as UTF-8."""
    raw = read_regular(
        path, shown, LIMIT_BYTES, inside=folder, missing=lambda: "; correct `file` in dataset.yaml"
    )
    if not raw:
        raise BadInput(f"{shown}:1: the file is empty; record again or take it out of dataset.yaml")
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        notes.append(f"{shown}:1: is UTF-16, read as such")
        if len(raw) > UTF16_LIMIT_BYTES:
            raise BadInput(
                f"{shown}: has {len(raw) / 1e6:.0f} MB in UTF-16, more than {UTF16_LIMIT_BYTES / 1e6:.0f} MB;"
                " save it as UTF-8"
            )
        try:
            return np.frombuffer(raw.decode("utf-16").encode("utf-8"), dtype=np.uint8)
        except UnicodeError as error:
            raise BadInput(f"{shown}: begins as UTF-16 but is none ({error}); save it as UTF-8") from None
    if raw.startswith(b"\xef\xbb\xbf"):
        notes.append(f"{shown}:1: starts with a byte order mark, which is skipped")
    return np.frombuffer(raw, dtype=np.uint8)
