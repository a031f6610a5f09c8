"""Spreadsheets (xlsx, xls, ods): every sheet that holds a table of numbers."""

from __future__ import annotations

import dataclasses
import datetime
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.importing.delimited import SIGNS, ambiguous
from needle_rig.importing.header import read_header
from needle_rig.importing.recording import SHEETS, Column, Read
from needle_rig.importing.text_rows import number_form, value_of
from needle_rig.importing.words import words_column

FEWEST_TEXTS = 3
"""Numbers stored as text by which a column is known: three rows begin a table."""
_EPOCH = datetime.datetime(1970, 1, 1)


def read_spreadsheet(path: Path, shown: str) -> Read:
    """Dialect in words, columns and rates by sheet. Raises BadInput."""
    calamine = needed("python_calamine", "a spreadsheet", "import")
    try:
        book = calamine.CalamineWorkbook.from_path(str(path))
        sheets = {name: book.get_sheet_by_name(name).to_python() for name in book.sheet_names}
    except Exception as error:  # noqa: BLE001 - the library raises several kinds, some of them Rust's panics
        raise BadInput(
            f"{shown}: cannot be read as a spreadsheet: {str(error)[:200]}; save it again"
        ) from None
    columns: list[Column] = []
    rates: dict[str, float] = {}
    for sheet, rows in sheets.items():
        found, rate_hz = _table(rows, sheet, shown)
        columns += found
        if rate_hz is not None:
            rates[sheet] = rate_hz
    tables = {c.table for c in columns}
    if not tables:
        raise BadInput(
            f"{shown}: no sheet holds a table of numbers; put one row a sample below a row of names"
        )
    if len(tables) > 1:
        columns = [Column(f"{c.table}/{c.name}", c.unit, c.values, c.table, fault=c.fault) for c in columns]
    return f"{SHEETS}, {', '.join(sorted(tables))}", tuple(columns), rates


def _table(rows: list[list[object]], sheet: str, shown: str) -> tuple[list[Column], float | None]:
    """The columns of a sheet: those with numbers below the first three rows that have as many as any."""
    rows = _with_numbers(rows)
    numbers = [sum(_number(cell) is not None for cell in row) for row in rows]
    usual = int(np.median([n for n in numbers if n])) if any(numbers) else 0
    begins = [k for k in range(len(rows) - 2) if usual and min(numbers[k : k + 3]) >= usual]
    if not begins:
        return [], None
    first = begins[0]
    # a formula that was never calculated has no value here
    width = max(k for k, cell in enumerate(rows[first]) if not _is_missing(cell)) + 1
    header = read_header([[str(c) for c in row[:width]] for row in rows[:first]], width)
    columns = []
    for k in range(width):
        cells = [row[k] if k < len(row) else "" for row in rows[first:]]
        found = [_number(cell) for cell in cells]
        bad = next((n for n, c in enumerate(cells) if found[n] is None and not _is_missing(c)), None)
        values = np.array([math.nan if v is None else v for v in found])
        if not np.isfinite(values).any():
            if all(_is_missing(cell) for cell in cells):
                column = Column(header.names[k], header.units[k], values, fault="holds no number")
            else:
                words = np.array([b"" if _is_missing(c) else str(c).encode() for c in cells])
                column = words_column(header.names[k], header.units[k], [words], "utf-8")
            columns.append(dataclasses.replace(column, table=sheet))
            continue
        if bad is not None:
            raise BadInput(
                f"{shown}:{sheet}, row {first + bad + 1}: {header.names[k]}: {str(cells[bad])[:40]!r} is no "
                "number; correct the cell, or leave it empty when the sample is missing"
            )
        unit = "s" if isinstance(rows[first][k], datetime.date | datetime.time) else header.units[k]
        columns.append(Column(header.names[k], unit, values, sheet))
    return columns, header.rate_hz


def _with_numbers(rows: list[list[object]]) -> list[list[object]]:
    """The rows, with numbers that are stored as text as numbers, where a column's texts are of one form."""
    width = max(map(len, rows), default=0)
    changed = [list(row) for row in rows]
    for k in range(width):
        cells = ((n, row[k]) for n, row in enumerate(rows) if k < len(row))
        texts = {n: cell.strip() for n, cell in cells if isinstance(cell, str)}
        comma, group, found = _form(texts)
        if len(found) < FEWEST_TEXTS or ambiguous(list(found.values()), comma, group):
            continue
        for n, text in found.items():
            changed[n][k] = value_of(text, group)
    return changed


def _form(texts: Mapping[int, str]) -> tuple[bool, str, dict[int, str]]:
    """Decimal sign and sign between thousands in which most texts are numbers, and those that are."""
    best: tuple[bool, str, dict[int, str]] = False, "", {}
    for comma, group in SIGNS:
        form = number_form(comma, group)
        found = {n: text for n, text in texts.items() if form.fullmatch(text)}
        if len(found) > len(best[2]):
            best = comma, group, found
    return best


def _is_missing(cell: object) -> bool:
    return isinstance(cell, str) and cell.strip().lower() in (
        "",
        "nan",
        "na",
        "n/a",
        "#n/a",
        "-",
        "null",
        "none",
    )


def _number(cell: object) -> float | None:
    """A cell's number; of a date the seconds since 1970, of a time those since midnight."""
    if isinstance(cell, bool):
        return None
    if isinstance(cell, int | float):
        return float(cell)
    if isinstance(cell, datetime.datetime):
        return (cell - _EPOCH).total_seconds()
    if isinstance(cell, datetime.time):
        return cell.hour * 3600 + cell.minute * 60 + cell.second + cell.microsecond * 1e-6
    if isinstance(cell, datetime.timedelta):
        return cell.total_seconds()
    return None
