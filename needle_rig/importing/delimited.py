"""Delimited text: any delimiter, decimal comma, rows above the table, LabVIEW's and others' headers."""

from __future__ import annotations

import codecs
import dataclasses
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.importing.header import Header, read_header, unique
from needle_rig.importing.recording import MAX_COLUMNS, Column, Read
from needle_rig.importing.text_rows import (
    NULLS,
    POINT,
    STAMP,
    Shape,
    cells_of,
    number_form,
    plain_spaces,
    read_rows,
)
from needle_rig.importing.words import words_column

HEAD_BYTES = 1 << 18
"""Where the table must have begun; headers of data loggers have some hundred lines."""
SEEN_ROWS = 200
"""Rows of the table from which its delimiter and decimal sign are found."""
_DELIMITERS = ("\t", ";", ",", "|", " ")
SIGNS = (
    (False, ""),
    (True, ""),
    (False, ","),
    (True, "."),
    (False, " "),
    (True, " "),
    (False, "'"),
    (True, "'"),
)
"""Decimal comma or not, and the sign between thousands; the first that reads most is taken."""
_GROUPS = {"": "", ".": "a point", ",": "a comma", "'": "an apostrophe", " ": "a space"}
_NAMES = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "spaces"}


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
    group: str
    """Sign between thousands, empty without one."""
    stamped: bool
    """Every line begins with the time at which a serial monitor received it, and an arrow."""
    unclear: tuple[str, ...]
    """By column: why its numbers can be read in two ways; empty where they cannot."""

    def shape(self, encoding: str, shown: str) -> Shape:
        """How the rows are read of a file of that encoding, called `shown` in errors."""
        names = tuple(self.header.names)
        return Shape(
            self.delimiter,
            self.comma,
            self.first_line,
            self.width,
            self.words,
            names,
            encoding,
            shown,
            self.group,
            self.stamped,
        )

    def told(self, encoding: str) -> str:
        decimal = ", decimal comma" if self.comma else ""
        decimal += f", thousands by {_GROUPS[self.group]}" if self.group else ""
        where = f", table from line {self.first_line + 1}" if self.first_line != 1 else ""
        code = "" if encoding == "utf-8" else f", {encoding}"
        return f"text with {_NAMES[self.delimiter]}{decimal}{where}{code}"


def read_delimited(path: Path, shown: str) -> Read:
    """Dialect in words, columns and rates of a text file. Raises BadInput with file and line."""
    head, encoding = _head(path, shown)
    lines = head.split("\n")
    if len(head) >= HEAD_BYTES:
        lines.pop()
    lines = [line.rstrip("\r") for line in lines]
    dialect = _dialect(lines, shown)
    names, units = dialect.header.names, dialect.header.units
    shape = dialect.shape(encoding, shown)
    values, words = read_rows(path, shape)
    columns, numeric = [], iter(values)
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        if k in words:
            columns.append(words_column(name, unit, words[k], shape.codec))
        else:
            columns.append(Column(name, unit, next(numeric)))
    columns = [
        dataclasses.replace(
            c,
            fault=c.fault or dialect.unclear[k] or ("" if np.isfinite(c.values).any() else "holds no number"),
        )
        for k, c in enumerate(columns)
    ]
    rates = {} if dialect.header.rate_hz is None else {"": dialect.header.rate_hz}
    return dialect.told(encoding), tuple(columns), rates


def _head(path: Path, shown: str) -> tuple[str, str]:
    with path.open("rb") as file:
        raw = file.read(HEAD_BYTES)
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return raw[: len(raw) // 2 * 2].decode("utf-16", "replace"), "utf-16"
    if b"\0" in raw:
        raise BadInput(
            f"{shown}: is neither text nor a format known here; export it as CSV, Parquet, MF4 or TDMS from"
            " the program that wrote it"
        )
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(raw)
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace"), "Windows-1252"
    return text, "utf-8"


def _dialect(lines: Sequence[str], shown: str) -> _Dialect:
    best: tuple[tuple[int, int, int], _Dialect] | None = None
    filled = [line for line in lines if line.strip()]
    stamped = sum(STAMP.match(line) is not None for line in filled) > len(filled) / 2
    for delimiter in _DELIMITERS:
        told = [_with_stamp(line, delimiter) for line in lines] if stamped else lines
        for comma, group in SIGNS:
            if (comma and delimiter == ",") or group == " " == delimiter:
                continue
            found = _table(told, delimiter, comma, group)
            if found is None:
                continue
            first, rows, width, words, unclear = found
            rank = (rows, -sum(words), width)
            if best is None or rank > best[0]:
                above = [cells_of(line, delimiter) for line in told[:first]]
                header = read_header(above, width)
                if stamped:
                    names = unique(["recorded at", *header.names[1:]])
                    header = dataclasses.replace(header, names=names)
                best = (
                    rank,
                    _Dialect(delimiter, comma, first, width, header, words, group, stamped, unclear),
                )
    if best is None:
        raise BadInput(
            f"{shown}: no table of numbers begins in its first {len(lines)} lines; "
            "save it with one row a sample and one delimiter between columns"
        )
    if best[1].width > MAX_COLUMNS:
        raise BadInput(f"{shown}: {best[1].width} columns, more than {MAX_COLUMNS}; keep those of the rig")
    _refuse_halves(lines, best[1], shown)
    return best[1]


def _with_stamp(line: str, delimiter: str) -> str:
    """A line with the time of its arrival as a field of its own; the header may have come without one."""
    found = STAMP.match(line)
    begin = found[1] if found else "arrival"
    return f"{begin}{delimiter}{line[found.end() if found else 0 :]}" if line.strip() else line


def _refuse_halves(lines: Sequence[str], dialect: _Dialect, shown: str) -> None:
    """Raise BadInput for decimal commas between commas: each number would be two columns."""
    above = [cells_of(line, ",") for line in lines[: dialect.first_line] if line.strip()]
    if dialect.delimiter != "," or not above:
        return
    names = above[-1]
    plain = not any(POINT.fullmatch(name) for name in names)
    if len(names) > 1 and plain and dialect.width in (2 * len(names), 2 * len(names) - 1):
        raise BadInput(
            f"{shown}:{dialect.first_line + 1}: {dialect.width} fields below {len(names)} names: decimal"
            " commas between commas; save it with decimal points, or with semicolons between columns"
        )


def _table(
    lines: Sequence[str], delimiter: str, comma: bool, group: str
) -> tuple[int, int, int, tuple[bool, ...], tuple[str, ...]] | None:
    """First line, rows, width, words and doubts by column, of the table in `lines` if there is one."""
    filled = [n for n, line in enumerate(lines) if line.strip(" \t\r")]
    if not filled:
        return None
    tail = [cells_of(lines[n], delimiter) for n in filled[-SEEN_ROWS - 1 : -1] or filled]
    width = Counter(map(len, tail)).most_common(1)[0][0]
    tail = [row for row in tail if len(row) == width]
    number = number_form(comma, group)
    words = tuple(
        all(not number.fullmatch(row[k]) and row[k] not in NULLS for row in tail) for k in range(width)
    )
    numeric = [k for k in range(width) if not words[k]]
    if not numeric:
        return None
    rows = [(n, cells_of(lines[n], delimiter)) for n in filled]
    good = [
        n
        for n, row in rows
        if len(row) == width
        and all(number.fullmatch(row[k]) or row[k] in NULLS for k in numeric)
        and any(number.fullmatch(row[k]) for k in numeric)
    ]
    numbers = set(good)
    seen = [row for n, row in rows if n in numbers]
    if comma and not any("," in row[k] for row in seen for k in numeric):
        return None
    if group and not any(_is_grouped(row[k], comma, group) for row in seen for k in numeric):
        return None
    unclear = tuple(
        "" if words[k] else ambiguous([row[k] for row in seen], comma, group) for k in range(width)
    )
    # Lines of a header may look like a row of the table; three in a row begin it.
    place = {n: k for k, n in enumerate(filled)}
    begins = [n for k, n in enumerate(good) if k + 2 < len(good) and place[good[k + 2]] == place[n] + 2]
    return (begins[0], len(good), width, words, unclear) if begins else None


def _is_grouped(cell: str, comma: bool, group: str) -> bool:
    """Whether a cell can be nothing but a number with thousands apart."""
    plain = plain_spaces(cell)
    return (
        plain.count(group) > 1
        or (group in plain and ("," if comma else ".") in plain)
        or (group in " '" and group in plain)
    )


def ambiguous(cells: Sequence[str], comma: bool, group: str) -> str:
    """Why numbers of a column may be thousands or decimals, empty where they cannot.

    A writer of decimals writes them in every number, or drops zeros; one of thousands has three digits after
    every sign, and none in numbers below a thousand.
    """
    sign = group if group and group in ".," else "," if comma else "."
    if group and (group not in ".," or any(_is_grouped(cell, comma, group) for cell in cells)):
        return ""
    with_sign = [cell for cell in cells if sign in cell]
    three = with_sign and all(_THREE[sign].fullmatch(cell) for cell in with_sign)
    if not three or (
        not group and not any(cell and cell not in NULLS and sign not in cell for cell in cells)
    ):
        return ""
    return (
        f"{with_sign[0]!r} may be {with_sign[0].replace(sign, '')} or have three decimals; save it without a "
        "sign between thousands"
    )


_THREE = {sign: re.compile(rf"[-+]?[1-9]\d{{0,2}}\{sign}\d{{3}}") for sign in ".,"}
