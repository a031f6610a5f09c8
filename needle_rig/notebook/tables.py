"""Numbers as structured arrays, and as pandas frames where pandas is there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from needle_rig.errors import BadInput

if TYPE_CHECKING:
    from pandas import DataFrame

Table = npt.NDArray[Any]


def table_of(rows: Iterable[Mapping[str, Any]], names: Iterable[str] = ()) -> Table:
    """Rows as a structured array: text as it is long, everything else as float.

    `names` are the columns of a table that has no row.
    """
    listed = [dict(row) for row in rows]
    if not listed:
        return np.empty(0, dtype=[(name, float) for name in names])
    return columns_of(
        {
            name: np.array([row[name] for row in listed], dtype=str if isinstance(value, str) else float)
            for name, value in listed[0].items()
        }
    )


def columns_of(columns: Mapping[str, npt.NDArray[Any]]) -> Table:
    """Columns of one length as a structured array."""
    size = len(next(iter(columns.values()), ()))
    table = np.empty(size, dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table


def stacked(tables: Iterable[Table]) -> Table:
    """Tables of the same columns below each other; a column that one of them lacks is NaN there."""
    listed = list(tables)
    names = {name: of.dtype[name].kind for of in listed for name in of.dtype.names or ()}
    return columns_of(
        {
            name: np.concatenate(
                [of[name] if name in (of.dtype.names or ()) else _none(kind, len(of)) for of in listed]
            )
            for name, kind in names.items()
        }
    )


def _none(kind: str, size: int) -> npt.NDArray[Any]:
    return np.full(size, "" if kind == "U" else np.nan)


def frame(table: Table) -> DataFrame:
    """A table as a pandas DataFrame. Raises BadInput where pandas is missing."""
    try:
        import pandas
    except ImportError:
        raise BadInput(
            "a DataFrame needs the package pandas, which is not installed here: pip install pandas"
        ) from None
    return pandas.DataFrame({name: table[name] for name in table.dtype.names or ()})


def or_nan(value: float | str | None) -> float:
    """A number; NaN where there is none."""
    return np.nan if value is None else float(value)
