"""Rows of delimited text to columns: numbers, and words as they are written."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from needle_rig.errors import BadInput
from needle_rig.importing.text_kernel import POWERS, SPACES, UNSURE, padded, parsed
from needle_rig.numerics import Array

RECODED_BYTES = 1_000_000_000
"""Text in UTF-16 is rewritten in memory before it is read."""
CHUNK_BYTES = 1 << 24
"""Rows that are looked at together."""
MOST_DOUBTED = 1 << 16
"""Numbers of a chunk that may be in doubt; of those with 20 digits and more it is one in some hundred."""

POINT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
STAMP = re.compile(r"^(\d\d:\d\d:\d\d(?:\.\d+)?) ?-> ?")
"""Of a line that a serial monitor received."""
_STAMP_BYTES = re.compile(STAMP.pattern.encode(), re.MULTILINE)
NULLS = (
    *("", "NaN", "nan", "NAN", "-NaN", "-nan", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "-", "--"),
    *("1.#QNAN", "-1.#IND", "1.#INF", "-1.#INF", "inf", "-inf", "Inf", "-Inf", "INF", "-INF"),
)
_NULLS = padded(NULLS)
_CODECS = {"Windows-1252": "cp1252", "utf-16": "utf-8"}

Words = npt.NDArray[np.bytes_]


@dataclass(frozen=True)
class Shape:
    """How the rows of a file are read."""

    delimiter: str
    """A space stands for any number of spaces and tabs."""
    comma: bool
    """Numbers have a decimal comma."""
    first_line: int
    """Of the table, from 0."""
    width: int
    words: tuple[bool, ...]
    """Columns that hold words or dates."""
    names: tuple[str, ...]
    """Of the columns, for errors."""
    encoding: str
    shown: str
    """Stands for the file in errors."""
    group: str = ""
    """Sign between thousands: a point, a comma, an apostrophe, or a space for any kind of space."""
    stamped: bool = False
    """Lines begin with a time and an arrow, which are a field of their own."""

    @property
    def codec(self) -> str:
        """How words are encoded in the rows that are read."""
        return _CODECS.get(self.encoding, self.encoding)


def read_rows(path: Path, shape: Shape) -> tuple[list[Array], dict[int, list[Words]]]:
    """Numbers (rows,) of each column without words, NaN where there is none; words by column, in parts.

    Rows without a value are left out, and one that is cut off at the end. Raises BadInput with file and line.
    """
    words: dict[int, list[Words]] = {k: [] for k, has in enumerate(shape.words) if has}
    filled = 0
    with _opened(path, shape) as file:
        # allotted once: parts that are joined at the end would take the memory twice
        values = np.empty((shape.width - len(words), _lines(file)))
        for _ in range(shape.first_line):
            file.readline()
        line = shape.first_line + 1
        while raw := file.read(CHUNK_BYTES):
            raw += file.readline()
            begin, line = line, line + raw.count(b"\n")
            if shape.stamped:
                raw = _STAMP_BYTES.sub(rb"\1" + shape.delimiter.encode(), raw)
            numbers, texts = _at_once(raw, shape) or _cell_by_cell(raw, begin, shape)
            empty = np.logical_and.reduce(np.isnan(numbers), axis=0)
            for column in texts.values():
                empty &= column == b""
            there = ~empty if empty.any() else slice(None)
            numbers = numbers[:, there]
            values[:, filled : filled + numbers.shape[1]] = numbers
            filled += numbers.shape[1]
            for k, column in texts.items():
                words[k].append(column[there])
    if not filled:
        raise BadInput(f"{shape.shown}: the table has no values")
    values = values[:, :filled]
    values[np.isinf(values)] = math.nan
    return list(values), words


@cache
def number_form(comma: bool, group: str) -> re.Pattern[str]:
    """What a number looks like: its decimal sign, and the sign between its thousands or none."""
    sign = "," if comma else r"\."
    whole = r"\d+"
    if group:
        between = {" ": r"[ \u00a0\u2009\u202f]", "'": "['’]"}.get(group, re.escape(group))
        whole = rf"(?:\d{{1,3}}(?:{between}\d{{3}})+|\d+)"
    return re.compile(rf"[-+]?({whole}{sign}?\d*|{sign}\d+)([eE][-+]?\d+)?")


def value_of(text: str, group: str) -> float:
    """The number that a text of `number_form` is."""
    plain = plain_spaces(text).replace(group, "") if group else text
    return float(plain.replace(",", "."))


def plain_spaces(text: str) -> str:
    """Every kind of space as a space, and every apostrophe as one."""
    return re.sub(r"[\u00a0\u2009\u202f]", " ", text).replace("’", "'")


def _lines(file: BinaryIO) -> int:
    """How many lines there are at most. The file is at its beginning, before and after."""
    count = 1
    while raw := file.read(CHUNK_BYTES):
        count += raw.count(b"\n")
    file.seek(0)
    return count


def cells_of(line: str, delimiter: str) -> list[str]:
    """The fields of a line, without the spaces around them."""
    if delimiter == " ":
        return line.split()
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]
    return [cell.strip() for cell in line.split(delimiter)]


def _opened(path: Path, shape: Shape) -> BinaryIO:
    if shape.encoding != "utf-16":
        return path.open("rb")
    if path.stat().st_size > RECODED_BYTES:
        raise BadInput(
            f"{shape.shown}: has {path.stat().st_size / 1e6:.0f} MB, more than the"
            f" {RECODED_BYTES / 1e6:.0f} MB that can be rewritten in memory; save it as UTF-8"
        )
    return io.BytesIO(path.read_bytes().decode("utf-16", "replace").encode())


def _at_once(raw: bytes, shape: Shape) -> tuple[Array, dict[int, Words]] | None:
    """The rows where every one has all fields and every number is one, or nothing; None otherwise."""
    is_word = np.array(shape.words)
    places = np.flatnonzero(is_word)
    most = raw.count(b"\n") + 1
    numbers = np.empty((is_word.size - places.size, most))
    spans = np.empty((most, places.size, 2), dtype=np.int64)
    doubted = np.empty((MOST_DOUBTED, 4), dtype=np.int64)
    delimiter = SPACES if shape.delimiter == " " else ord(shape.delimiter)
    point = ord("," if shape.comma else ".")
    text = np.frombuffer(raw, np.uint8)
    rows, doubts = parsed(text, delimiter, point, is_word, _NULLS, POWERS, numbers, spans, doubted)
    if rows in (UNSURE, 0):
        return None
    for column, row, begin, end in doubted[:doubts].tolist():
        numbers[column, row] = float(raw[begin:end].replace(b",", b"."))
    texts = {
        int(k): np.array([raw[begin:end] for begin, end in spans[:rows, word].tolist()])
        for word, k in enumerate(places)
    }
    return numbers[:, :rows], texts


def _cell_by_cell(raw: bytes, begin: int, shape: Shape) -> tuple[Array, dict[int, Words]]:
    """The rows, the first at the line `begin`, some of which are unlike the others. Raises BadInput."""
    numeric = [k for k, has in enumerate(shape.words) if not has]
    numbers: list[list[float]] = []
    texts: dict[int, list[bytes]] = {k: [] for k, has in enumerate(shape.words) if has}
    for line, row in _whole_rows(io.BytesIO(raw).readlines(), begin, shape):
        numbers.append([_number(row[k], line, k, shape) for k in numeric])
        for k, column in texts.items():
            column.append(row[k].strip(' "').encode(shape.codec, "replace"))
    values = np.array(numbers, dtype=np.float64).reshape(len(numbers), len(numeric))
    return values.T, {k: np.array(column, dtype=np.bytes_) for k, column in texts.items()}


def _whole_rows(rows: Sequence[bytes], begin: int, shape: Shape) -> Iterator[tuple[int, list[str]]]:
    """Line and cells of every row that is not blank, but for a last one that is cut off. Raises BadInput.

    A row that lost a field in its middle would put every value after it into a wrong column.
    """
    for line, raw in enumerate(rows, begin):
        if not raw.strip():
            continue
        row = cells_of(raw.decode(shape.codec, "replace").rstrip("\r\n"), shape.delimiter)
        if len(row) < shape.width and not raw.endswith(b"\n"):
            return
        if len(row) != shape.width:
            todo = (
                "complete or remove the row"
                if len(row) < shape.width
                else "complete the row, or cut the file where another table begins"
            )
            raise BadInput(
                f"{shape.shown}:{line}: {len(row)} fields where the table has {shape.width}; {todo}"
            )
        yield line, row


def _number(cell: str, line: int, column: int, shape: Shape) -> float:
    text = cell.strip('"').strip()
    if number_form(shape.comma, shape.group).fullmatch(text):
        return value_of(text, shape.group)
    if text in NULLS:
        return math.nan
    if text == shape.names[column]:
        raise BadInput(
            f"{shape.shown}:{line}: a second table begins here, with the names again; cut the file there, and"
            " give both files: they are taken as one recording after the other"
        )
    raise BadInput(
        f"{shape.shown}:{line}: {shape.names[column]}: {cell[:40]!r} is no number; correct it, or "
        "leave the field empty when the sample is missing"
    )
