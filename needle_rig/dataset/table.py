"""CSV files to arrays: any delimiter, decimal comma, byte order marks, UTF-16, long files thinned."""

from __future__ import annotations

import io
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from needle_rig.config.regular_file import read_regular
from needle_rig.errors import BadInput
from needle_rig.numerics import Array

MAX_SAMPLES = 20_000
"""Rows kept of one file: a model step costs microseconds, a fit takes thousands of passes."""
MAX_COLUMNS = 1000
"""Far above any rig's sensors; the names of columns are compared with each other."""
LIMIT_BYTES = 1_000_000_000
"""Ten million rows of eight columns take 700 MB; the file is held in memory while its rows are thinned."""
UTF16_LIMIT_BYTES = 300_000_000
"""Takes five times its size while it is converted."""
HEADER_BYTES = 65536
"""A line of names is shorter."""
CHUNK_BYTES = 4_000_000
"""Rows that are looked at together; as lines they take twice that."""

_MISSING = re.compile(rb"|-|[+-]?n.{0,3}", re.IGNORECASE)
"""Nothing, a lone minus, or one of nan, na, n/a, null, none."""
_COMMA_IS_POINT = bytes.maketrans(b",.", b".,")


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
    with `time_stem` must not go back. Of more than MAX_SAMPLES rows every n-th is used; of the others
    only the number of fields and the time are looked at.
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
    sample = data[start : start + 65536]
    comma = delimiter != "," and b"," in sample and b"." not in sample
    if delimiter != ",":
        how = "a decimal comma" if comma else "a decimal point"
        names = {";": "semicolons", "\t": "tabs"}
        notes.append(f"{shown}:{header_line}: read with {names[delimiter]} between columns and {how}")
    about = data.count(b"\n", start)
    every = -(-about // MAX_SAMPLES) if about > MAX_SAMPLES * 1.05 else 1
    text_at = columns.index(text_column) if text_column in columns else -1
    time_at = next((i for i, c in enumerate(columns) if i != text_at and c.startswith(time_stem)), -1)
    file = io.BytesIO(data)
    file.seek(start)
    form = _Format(shown, columns, delimiter.encode(), comma, text_at, time_at)
    used: list[tuple[int, bytes]] = []
    seen = 0
    for lines, rows in _rows(file, header_line + 1, form, notes):
        used.extend(zip(lines[-seen % every :: every], rows[-seen % every :: every], strict=True))
        seen += len(rows)
    if not used:
        raise BadInput(
            f"{shown}:{header_line}: no rows below the header; record again or leave the trial out"
        )
    if every > 1:
        notes.append(f"{shown}: has about {about:,} rows; one in {every} is used, {len(used):,} in all")
    return Table(
        tuple(c for i, c in enumerate(columns) if i != text_at),
        _numbers(used, form),
        np.array([line for line, _ in used], dtype=np.int64),
        np.array([_text(row, form) for _, row in used], dtype=np.str_),
        tuple(notes),
    )


@dataclass(frozen=True)
class _Format:
    """How the rows of a file are read; `text_at` and `time_at` are columns, −1 where there is none."""

    shown: str
    columns: tuple[str, ...]
    delimiter: bytes
    comma: bool
    text_at: int
    time_at: int


def _rows(
    file: io.BytesIO, line: int, form: _Format, notes: list[str]
) -> Iterator[tuple[Sequence[int], list[bytes]]]:
    """Lines and contents, a chunk at a time, of the rows that are not blank: whole, their times in order."""
    last_s = -math.inf
    while rows := file.readlines(CHUNK_BYTES):
        lines: Sequence[int] = range(line, line + len(rows))
        line += len(rows)
        end_s = _end_of_plain(rows, last_s, form)
        if end_s is None:
            filled = [(n, row) for n, row in zip(lines, rows, strict=True) if row.strip(b" \r\n")]
            whole = [(n, row) for n, row in filled if _is_whole(row, n, form, notes)]
            for n, row in whole:
                last_s = _time(row, n, last_s, form)
            lines, rows = [n for n, _ in whole], [row for _, row in whole]
        else:
            last_s = end_s
        yield lines, rows


def _end_of_plain(rows: list[bytes], last_s: float, form: _Format) -> float | None:
    """The last time of rows that all have every field and times in order, else None: a fast first look."""
    delimiter, at = form.delimiter, form.time_at
    if {row.count(delimiter) for row in rows} != {len(form.columns) - 1}:
        return None
    if at < 0:
        return last_s
    try:
        fields = (row.split(delimiter, at + 1)[at] for row in rows)
        times_s = [float(f.replace(b",", b".")) for f in fields] if form.comma else [*map(float, fields)]
    except ValueError:
        return None
    in_order = bool(np.all(np.diff(times_s, prepend=last_s) >= 0.0)) and times_s[-1] < math.inf
    return times_s[-1] if in_order else None


def _is_whole(row: bytes, line: int, form: _Format, notes: list[str]) -> bool:
    """Whether the row has all fields; False for a last row that is cut off. Raises BadInput."""
    fields, columns = row.count(form.delimiter) + 1, len(form.columns)
    if fields > columns:
        raise BadInput(
            f"{form.shown}:{line}: more fields than the header's {columns}; "
            "use another separator when numbers have a decimal comma"
        )
    if fields < columns and row.endswith(b"\n"):
        raise BadInput(
            f"{form.shown}:{line}: {fields} fields where the header has {columns}; complete or remove the row"
        )
    if fields < columns:
        notes.append(f"{form.shown}:{line}: the file ends in the middle of this row; it is left out")
    return fields == columns


def _time(row: bytes, line: int, last_s: float, form: _Format) -> float:
    """The time of the row. Raises BadInput when it is missing or before the last one."""
    if form.time_at < 0:
        return last_s
    time_s = _number(row.split(form.delimiter)[form.time_at], line, form.time_at, form)
    if math.isnan(time_s):
        raise BadInput(f"{form.shown}:{line}: the time is missing; fill it in or remove the row")
    if time_s < last_s:
        raise BadInput(
            f"{form.shown}:{line}: time goes back from {last_s:g} to {time_s:g}; "
            "cut the file there into two trials, or put the rows in order"
        )
    return time_s


def _numbers(used: list[tuple[int, bytes]], form: _Format) -> Array:
    """(rows, columns of numbers); NaN where a field says that there is no value."""
    places = [i for i in range(len(form.columns)) if i != form.text_at]
    try:
        rows = [
            _filled(row.translate(_COMMA_IS_POINT) if form.comma else row, form.delimiter) for _, row in used
        ]
        values = np.loadtxt(rows, delimiter=form.delimiter.decode(), usecols=places, comments=None, ndmin=2)
        if not np.isinf(values).any():
            return values
    except ValueError:
        pass  # another word for a missing value, quotes or what is no number: field by field
    values = np.empty((len(used), len(places)))
    for i, (line, row) in enumerate(used):
        fields = row.split(form.delimiter)
        values[i] = [_number(fields[place], line, place, form) for place in places]
    return values


def _filled(row: bytes, delimiter: bytes) -> bytes:
    """The row with a word where a field is empty."""
    empty, named = delimiter + delimiter, delimiter + b"nan" + delimiter
    whole = row.rstrip(b"\r\n")
    if whole.startswith(delimiter):
        whole = b"nan" + whole
    if whole.endswith(delimiter):
        whole += b"nan"
    return whole.replace(empty, named).replace(empty, named)


def _number(field: bytes, line: int, place: int, form: _Format) -> float:
    text = field.strip(b' \r\n"')
    if form.comma:
        text = text.translate(_COMMA_IS_POINT)
    with suppress(ValueError):
        if math.isfinite(value := float(text)) and b"_" not in text:
            return value
    if _MISSING.fullmatch(text):
        return math.nan
    found = field.decode("utf-8", "replace").strip()
    raise BadInput(
        f"{form.shown}:{line}: {form.columns[place]}: {found[:40]!r} is no number; "
        "correct it, or leave the field empty when the sample is missing"
    )


def _text(row: bytes, form: _Format) -> str:
    if form.text_at < 0:
        return ""
    return row.split(form.delimiter)[form.text_at].decode("utf-8", "replace").strip().strip('"')


def _header(data: bytes, shown: str) -> tuple[int, int, str]:
    """Line of the header, where the rows start, and the header's text."""
    file = io.BytesIO(data)
    for line, block in enumerate(iter(lambda: file.readline(HEADER_BYTES), b""), 1):
        text = block.decode("utf-8", "replace").strip("\ufeff \r\n")
        if text and not text.startswith("#"):
            return line, file.tell() if block.endswith(b"\n") else len(data), text
    raise BadInput(f"{shown}:1: the file is empty; record again or take it out of dataset.yaml")


def _looks_numeric(columns: tuple[str, ...]) -> bool:
    try:
        return all(np.isfinite(float(c.replace(",", "."))) for c in columns if c)
    except ValueError:
        return False


def _content(path: Path, folder: Path, shown: str, notes: list[str]) -> bytes:
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
            return raw.decode("utf-16").encode("utf-8")
        except UnicodeError as error:
            raise BadInput(f"{shown}: begins as UTF-16 but is none ({error}); save it as UTF-8") from None
    if raw.startswith(b"\xef\xbb\xbf"):
        notes.append(f"{shown}:1: starts with a byte order mark, which is skipped")
    return raw
