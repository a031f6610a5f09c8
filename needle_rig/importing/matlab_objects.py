"""MATLAB's tables and timetables, which are objects in a .mat file, by mat-io."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.importing.arrays import Leaf

UNITS = ("VariableUnits", "varUnits")
"""What a table, and what a timetable calls the units of its columns."""


def tables_in(path: Path, shown: str) -> dict[str, Leaf]:
    """The columns of all tables by name of the table; timetables have their times. Raises BadInput."""
    matio = needed("matio", "a table of MATLAB", "import")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of objects that are no tables
            content = matio.load_from_mat(str(path), add_table_attrs=True)
    except Exception as error:  # noqa: BLE001 - damaged files raise anything, down to struct's errors
        raise BadInput(
            f"{shown}: its objects cannot be read: {str(error)[:200]}; save them as arrays, with"
            " table2struct(…, 'ToScalar', true)"
        ) from None
    leaves: dict[str, Leaf] = {}
    for name, value in content.items():
        if hasattr(value, "columns"):
            _table(str(name), value, leaves)
    return leaves


def _table(name: str, frame: Any, leaves: dict[str, Leaf]) -> None:
    index = np.asarray(frame.index)
    if index.dtype.kind in "mM":
        leaves[f"{name}/{frame.index.name or 'Time'}"] = (index, "s")
    told: list[object] = next((list(frame.attrs[key]) for key in UNITS if key in frame.attrs), [])
    units = [str(unit) for unit in told] if len(told) == len(frame.columns) else [""] * len(frame.columns)
    for column, unit in zip(frame.columns, units, strict=True):
        leaves[f"{name}/{column}"] = (np.asarray(frame[column]), unit)
