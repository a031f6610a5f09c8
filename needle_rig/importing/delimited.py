"""Delimited text: any delimiter, decimal comma, rows above the table, LabVIEW's and others' headers."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.importing.extra import needed
from needle_rig.importing.header import Header, read_header
from needle_rig.importing.recording import MAX_COLUMNS, Column

HEAD_BYTES = 1 << 18
"""Where the table must have begun; headers of data loggers have some hundred lines."""
SEEN_ROWS = 200
"""Rows of the table from which its delimiter and decimal sign are found."""
RECODED_BYTES = 1_000_000_000
"""Text in UTF-16 or between runs of spaces is rewritten in memory before it is read."""
CHUNK_BYTES = 1 << 24

_DELIMITERS = ("\t", ";", ",", "|", " ")
_NAMES = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "spaces"}
_POINT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_COMMA = re.compile(r"[-+]?(\d+,?\d*|,\d+)([eE][-+]?\d+)?")
_NULLS = (
    *("", "NaN", "nan", "NAN", "-NaN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "-", "--"),
    *("1.#QNAN", "-1.#IND", "1.#INF", "-1.#INF", "inf", "-inf", "Inf", "-Inf", "INF", "-INF"),
)
_TIME_FORMATS = ("%Y-%m-%d", "%d.%m.%Y", "%m/%d/%Y", "%Y/%m/%d", "%d/%m/%Y")


@dataclass(frozen=True)
class _Dialect:
    delimiter: str
    comma: bool
    first_line: int
    """Of the table, from 0."""
    width: int
    header: Header
    words: tuple[bool, ...]
    """Columns that hold words or dates."""

    def told(self, encoding: str) -> str:
        decimal = ", decimal comma" if self.comma else ""
        where = f", table from line {self.first_line + 1}" if self.first_line != 1 else ""
        code = "" if encoding == "utf-8" else f", {encoding}"
        return f"text with {_NAMES[self.delimiter]}{decimal}{where}{code}"


def read_delimited(path: Path, shown: str) -> tuple[str, tuple[Column, ...], dict[str, float]]:
    """Dialect in words, columns and rates of a text file. Raises BadInput with file and line."""
    head, encoding = _head(path, shown)
    lines = head.split("\n")
    if len(head) >= HEAD_BYTES:
        lines.pop()
    lines = [line.rstrip("\r") for line in lines]
    dialect = _dialect(lines, shown)
    frame = _frame(path, encoding, dialect, shown)
    columns = []
    for k, (name, unit) in enumerate(zip(dialect.header.names, dialect.header.units, strict=True)):
        series = frame.to_series(k)
        columns.append(_words(name, unit, series) if dialect.words[k] else _numbers(name, unit, series))
    columns = [c for c in columns if c.labels or np.isfinite(c.values).any()]
    rates = {} if dialect.header.rate_hz is None else {"": dialect.header.rate_hz}
    return dialect.told(encoding), tuple(columns), rates


def _head(path: Path, shown: str) -> tuple[str, str]:
    with path.open("rb") as file:
        raw = file.read(HEAD_BYTES)
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return raw[: len(raw) // 2 * 2].decode("utf-16", "replace"), "utf-16"
    if b"\0" in raw:
        raise BadInput(f"{shown}: is neither text nor a format known here; see needle-rig import --help")
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(raw)
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace"), "Windows-1252"
    return text, "utf-8"


def _dialect(lines: Sequence[str], shown: str) -> _Dialect:
    best: tuple[tuple[int, int, int], _Dialect] | None = None
    for delimiter in _DELIMITERS:
        for comma in (False, True) if delimiter != "," else (False,):
            found = _table(lines, delimiter, comma)
            if found is None:
                continue
            first, rows, width, words = found
            rank = (rows, -sum(words), width)
            if best is None or rank > best[0]:
                above = [_cells(line, delimiter) for line in lines[:first]]
                best = rank, _Dialect(delimiter, comma, first, width, read_header(above, width), words)
    if best is None:
        raise BadInput(
            f"{shown}: no table of numbers begins in its first {len(lines)} lines; "
            "save it with one row a sample and one delimiter between columns"
        )
    if best[1].width > MAX_COLUMNS:
        raise BadInput(f"{shown}: {best[1].width} columns, more than {MAX_COLUMNS}; keep those of the rig")
    _refuse_halves(lines, best[1], shown)
    return best[1]


def _refuse_halves(lines: Sequence[str], dialect: _Dialect, shown: str) -> None:
    """Raise BadInput for decimal commas between commas: each number would be two columns."""
    above = [_cells(line, ",") for line in lines[: dialect.first_line] if line.strip()]
    if dialect.delimiter != "," or not above:
        return
    names = above[-1]
    plain = not any(_POINT.fullmatch(name) for name in names)
    if len(names) > 1 and plain and dialect.width in (2 * len(names), 2 * len(names) - 1):
        raise BadInput(
            f"{shown}:{dialect.first_line + 1}: {dialect.width} fields below {len(names)} names: decimal"
            " commas between commas; save it with decimal points, or with semicolons between columns"
        )


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]
    return [cell.strip() for cell in line.split(delimiter)]


def _table(
    lines: Sequence[str], delimiter: str, comma: bool
) -> tuple[int, int, int, tuple[bool, ...]] | None:
    """First line, rows, width, and which columns hold words, of the table in `lines` if there is one."""
    filled = [n for n, line in enumerate(lines) if line.strip(" \t\r")]
    if not filled:
        return None
    tail = [_cells(lines[n], delimiter) for n in filled[-SEEN_ROWS - 1 : -1] or filled]
    width = Counter(map(len, tail)).most_common(1)[0][0]
    tail = [row for row in tail if len(row) == width]
    number = _COMMA if comma else _POINT
    words = tuple(
        all(not number.fullmatch(row[k]) and row[k] not in _NULLS for row in tail) for k in range(width)
    )
    numeric = [k for k in range(width) if not words[k]]
    if not numeric or (comma and not any("," in row[k] for row in tail for k in numeric)):
        return None
    rows = [(n, _cells(lines[n], delimiter)) for n in filled]
    good = [
        n
        for n, row in rows
        if len(row) == width
        and all(number.fullmatch(row[k]) or row[k] in _NULLS for k in numeric)
        and any(number.fullmatch(row[k]) for k in numeric)
    ]
    # Lines of a header may look like a row of the table; three in a row begin it.
    place = {n: k for k, n in enumerate(filled)}
    begins = [n for k, n in enumerate(good) if k + 2 < len(good) and place[good[k + 2]] == place[n] + 2]
    return (begins[0], len(good), width, words) if begins else None


def _frame(path: Path, encoding: str, dialect: _Dialect, shown: str) -> Any:
    """The table as a polars frame of strings and Float64."""
    pl = needed("polars", "text with columns")
    source: Path | bytes = path
    lines = dialect.first_line
    if encoding == "utf-16" or dialect.delimiter == " ":
        source = _recoded(path, encoding, dialect, shown)
        lines = 0
    names = [f"c{k}" for k in range(dialect.width)]
    options: dict[str, object] = {
        "has_header": False,
        "separator": "\t" if dialect.delimiter == " " else dialect.delimiter,
        "skip_lines": lines,
        "encoding": "utf8-lossy",
    }
    plain = {n: pl.String if words else pl.Float64 for n, words in zip(names, dialect.words, strict=True)}
    try:
        frame = pl.read_csv(source, schema=plain, decimal_comma=dialect.comma, **options)
    except pl.exceptions.PolarsError:
        # Words for what is missing, spaces around numbers: three times slower.
        try:
            frame = pl.read_csv(source, schema=dict.fromkeys(names, pl.String), **options)
        except pl.exceptions.PolarsError as error:
            raise BadInput(_first_bad(path, encoding, dialect, shown, str(error))) from None
        frame = _cast(frame, path, encoding, dialect, shown)
    return _whole(frame, path, encoding, dialect, shown)


def _cast(frame: Any, path: Path, encoding: str, dialect: _Dialect, shown: str) -> Any:
    """A frame of strings with its columns of numbers as such. Raises BadInput with file and line."""
    pl = needed("polars", "text with columns")
    for name, words in zip(frame.columns, dialect.words, strict=True):
        if words:
            continue
        text = frame.get_column(name).str.strip_chars(' \r"')
        text = text.set(text.is_in(list(_NULLS)), None)
        if dialect.comma:
            text = text.str.replace(",", ".", literal=True)
        numbers = text.cast(pl.Float64, strict=False)
        if numbers.null_count() > text.null_count():
            raise BadInput(_first_bad(path, encoding, dialect, shown, "a field is no number"))
        frame = frame.with_columns(numbers.alias(name))
    return frame


def _recoded(path: Path, encoding: str, dialect: _Dialect, shown: str) -> bytes:
    if path.stat().st_size > RECODED_BYTES:
        raise BadInput(
            f"{shown}: has {path.stat().st_size / 1e6:.0f} MB, more than the {RECODED_BYTES / 1e6:.0f} MB "
            "that can be rewritten in memory; save it as UTF-8 with commas or tabs between columns"
        )
    data = path.read_bytes()
    if encoding == "utf-16":
        data = data.decode("utf-16", "replace").encode()
    data = data.replace(b"\r\n", b"\n")
    start = 0
    for _ in range(dialect.first_line):
        start = data.index(b"\n", start) + 1
    data = data[start:]
    if dialect.delimiter == " ":
        data = re.sub(rb"[ \t]*\n[ \t]*", b"\n", data.strip())
        data = re.sub(rb"[ \t]+", b"\t", data)
    return data


def _whole(frame: Any, path: Path, encoding: str, dialect: _Dialect, shown: str) -> Any:
    """The frame, when every row has all fields; a row cut off at the end, and blank ones, are left out.

    A row that lost a field in its middle would put every value after it into a wrong column.
    """
    last = frame.get_column(frame.columns[-1])
    if last.null_count() == 0:
        return frame
    pl = needed("polars", "text with columns")
    blank = frame.select(pl.all_horizontal(pl.all().is_null())).to_series()
    kept = frame.filter(~blank)
    if not kept.height:
        raise BadInput(f"{shown}: the table has no values")
    suspects = kept.get_column(kept.columns[-1]).is_null()
    if not suspects.any():
        return kept
    for number, row in _rows(path, encoding, dialect):
        if row is None:  # the file ends in the middle of its last row
            return kept[:-1]
        if len(row) != dialect.width:
            raise BadInput(
                f"{shown}:{number}: {len(row)} fields where the table has {dialect.width}; complete or "
                "remove the row"
            )
    return kept


def _rows(path: Path, encoding: str, dialect: _Dialect) -> Iterator[tuple[int, list[str] | None]]:
    """Line number from 1 and cells of every row that is not blank; None for a last one that is cut off."""
    codec = {"Windows-1252": "cp1252"}.get(encoding, encoding)
    with open(path, encoding=codec, errors="replace", newline="\n") as file:
        for number, line in enumerate(file, 1):
            if number <= dialect.first_line or not line.strip():
                continue
            row = _cells(line.rstrip("\r\n"), dialect.delimiter)
            cut = len(row) < dialect.width and not line.endswith("\n")
            yield number, (None if cut else row)


def _first_bad(path: Path, encoding: str, dialect: _Dialect, shown: str, error: str) -> str:
    """The sentence on the first row that is none of the table."""
    number = _COMMA if dialect.comma else _POINT
    for at, row in _rows(path, encoding, dialect):
        if row is None:
            continue
        if len(row) != dialect.width:
            return (
                f"{shown}:{at}: {len(row)} fields where the table has {dialect.width}; "
                "complete the row, or cut the file where another table begins"
            )
        for k, cell in enumerate(row):
            if not dialect.words[k] and cell not in _NULLS and not number.fullmatch(cell.strip('"')):
                return (
                    f"{shown}:{at}: {dialect.header.names[k]}: {cell[:40]!r} is no number; correct it, or "
                    "leave the field empty when the sample is missing"
                )
    return f"{shown}: cannot be read as a table: {error.splitlines()[0][:200]}"


def _numbers(name: str, unit: str, series: Any) -> Column:
    values = series.fill_null(math.nan).to_numpy()
    result = np.asarray(values, dtype=np.float64)
    if np.isinf(result).any():
        result = np.where(np.isinf(result), math.nan, result)
    return Column(name, unit, result)


def _words(name: str, unit: str, series: Any) -> Column:
    """Dates as seconds since 1970; other words as places in the list of those that occur."""
    pl = needed("polars", "text with columns")
    text = series.str.strip_chars(' "')
    known = text.drop_nulls()
    shape = known[0] if len(known) else ""
    for day in _TIME_FORMATS:
        for between in (" ", "T"):
            sample = f"{day}{between}%H:%M:%S%.f"
            with_comma = "," in shape
            cleaned = (text.str.replace(",", ".", literal=True) if with_comma else text).str.strip_suffix("Z")
            dates = cleaned.str.to_datetime(sample, strict=False, time_unit="us")
            if dates.null_count() == text.null_count() and len(known):
                seconds = dates.dt.epoch("us").cast(pl.Float64) / 1e6
                return Column(name, "s", np.asarray(seconds.fill_null(math.nan).to_numpy(), dtype=np.float64))
    if shape and re.fullmatch(r"\d{1,2}:\d{2}:\d{2}([.,]\d+)?", shape):
        parts = text.str.replace(",", ".", literal=True).str.split(":")
        clock = [
            math.nan if p is None or len(p) != 3 else float(p[0]) * 3600 + float(p[1]) * 60 + float(p[2])
            for p in parts.to_list()
        ]
        return Column(name, "s", np.array(clock))
    labels = tuple(known.unique(maintain_order=True).to_list()[: MAX_COLUMNS + 1])
    if len(labels) > MAX_COLUMNS:
        return Column(name, unit, np.full(len(series), math.nan))
    places = {label: float(k) for k, label in enumerate(labels)}
    values = np.array([places.get(w, math.nan) for w in text.to_list()])
    return Column(name, unit, values, labels=labels)
