"""Rows above a table: which hold the columns' names and units, and what they say of its rate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from needle_rig.importing.unit_text import number_with_unit, split_name, unit_of

Cells = Sequence[str]

_COMMENT = re.compile(r"^(?:%|#|//|;|!)+\s*")
_RATE = re.compile(
    r"(sampl\w*|scan|meas\w*|acquisition|abtast\w*)?[\s_]*(rate|freq\w*|fs|hz)\b", re.IGNORECASE
)
_STEP = re.compile(
    r"(delta[\s_]*[xt]|d[xt]|wf_increment|(sampl\w*|time|scan)[\s_]*(interval|increment|period|step))",
    re.IGNORECASE,
)
_UNIT_KEY = re.compile(r"(y_unit_label|units?|einheit(en)?|dimension)", re.IGNORECASE)


@dataclass(frozen=True)
class Header:
    """Units, rates and other statements in the rows above a table."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    """As written, empty where none is."""
    rate_hz: float | None = None
    named: bool = True
    """False when nothing stands above the numbers and the names are made up."""


def read_header(above: Sequence[Cells], width: int) -> Header:
    """The header in `above` (cells of every row before the table) of a table of `width` columns."""
    rows = [_plain(row, width) for row in above]
    full = [row for row in rows if _is_names(row, width)]
    units = [""] * width
    names: list[str] = []
    if full:
        last = full[-1]
        if len(full) > 1 and _is_units(last) and not _is_units(full[-2]):
            units = _fitted(last, width)
            last = full[-2]
        names = _fitted(last, width)
    for row in rows:
        if len(row) > 1 and _UNIT_KEY.fullmatch(row[0]) and any(unit_of(cell) for cell in row[1:]):
            # LabVIEW names the units of the channels, not of the time before them.
            units = _fitted([units[0], *row[1:]], width)
    told = [split_name(name) for name in names]
    units = [u or (told[k][1] if k < len(told) else "") for k, u in enumerate(units)]
    units = [u if not _placeholder(u) else "" for u in units]
    return Header(
        unique(names or [f"column_{k + 1}" for k in range(width)]),
        tuple(u.strip().strip("[](){}").strip() for u in units),
        _rate_hz(rows),
        bool(names),
    )


def _plain(row: Cells, width: int) -> list[str]:
    """The row without quotes and without the sign of a comment, which may be a cell of its own."""
    cells = [cell.strip().strip('"').strip() for cell in row]
    if cells:
        cells[0] = _COMMENT.sub("", cells[0], count=1)
    return cells[1:] if len(cells) == width + 1 and not cells[0] else cells


def _placeholder(unit: str) -> bool:
    return unit.strip("[](){} ").lower() in ("", "-", "–", "1", "none", "n/a", "na")


def _is_names(row: Cells, width: int) -> bool:
    """Whether a row can be one of names or units: as wide as the table, and no numbers."""
    filled = [cell for cell in row if cell]
    if len(filled) > 1 and len(set(filled)) == 1:
        return False
    if not filled or not (width <= len(row) <= width + 1 or len(row) == width - 1 > 1):
        return False
    return not any(number_with_unit(cell) and not number_with_unit(cell)[1] for cell in filled)  # type: ignore[index]


def _is_units(row: Cells) -> bool:
    filled = [cell for cell in row if cell]
    known = sum(1 for cell in filled if unit_of(cell) is not None or _placeholder(cell))
    return known >= max(1, (len(filled) + 1) // 2)


def _fitted(row: Cells, width: int) -> list[str]:
    return [*row[:width], *[""] * (width - len(row))]


def unique(names: Sequence[str]) -> tuple[str, ...]:
    """The names without what cannot be shown, numbered where they repeat."""
    seen: dict[str, int] = {}
    result = []
    for k, name in enumerate(names):
        shown = "".join(c for c in name if c.isprintable()).strip() or f"column_{k + 1}"
        seen[shown] = seen.get(shown, 0) + 1
        result.append(shown if seen[shown] == 1 else f"{shown} ({seen[shown]})")
    return tuple(result)


def _rate_hz(rows: Sequence[Cells]) -> float | None:
    for row in rows:
        cells = [cell for cell in row if cell]
        if len(cells) == 1:
            cells = [part.strip() for part in re.split(r"[:=]|\s{2,}", cells[0], maxsplit=1)]
        if len(cells) < 2:
            continue
        key, unit_in_key = split_name(cells[0].strip(" :="))
        value = number_with_unit(cells[1])
        if value is None or not value[0] > 0:
            continue
        unit = value[1] or unit_in_key
        if _STEP.fullmatch(key):
            told = unit_of(unit) if unit else unit_of("s")
            if told is not None and told.dimension == "time":
                return 1.0 / (value[0] * told.si)
        if _RATE.fullmatch(key):
            factor = {"": 1.0, "hz": 1.0, "khz": 1e3, "1/s": 1.0, "s/s": 1.0}.get(unit.lower())
            if factor is not None:
                return value[0] * factor
    return None
