"""Data frames: Parquet, Feather and JSON lines, by polars."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.importing.arrays import MOST_SIDE
from needle_rig.importing.recording import MAX_COLUMNS, Column, Read
from needle_rig.importing.unit_text import split_name
from needle_rig.importing.words import words_column

_READERS = {b"PAR1": ("Parquet", "read_parquet"), b"ARROW1": ("Feather", "read_ipc")}


def is_frame(head: bytes) -> bool:
    """Whether a file that begins so is Parquet or Feather."""
    return head.startswith(tuple(_READERS))


def read_frame(path: Path, shown: str) -> Read:
    """Dialect in words, columns and no rates. Raises BadInput."""
    with path.open("rb") as file:
        head = file.read(8)
    kind, reader = next((told for magic, told in _READERS.items() if head.startswith(magic)), _LINES)
    polars = needed("polars", f"a file of {kind}", "import")
    try:
        frame = _lines(polars, path) if reader == _LINES[1] else getattr(polars, reader)(path)
    # the library raises several kinds, and Rust's panics, which are no Exception
    except (Exception, polars.exceptions.PanicException) as error:  # noqa: BLE001
        raise BadInput(f"{shown}: cannot be read as {kind}: {str(error)[:200]}; write it again") from None
    columns = [column for name in frame.columns for column in _columns(polars, frame[name], name)]
    if len(columns) > MAX_COLUMNS:
        raise BadInput(f"{shown}: {len(columns)} columns, more than {MAX_COLUMNS}; keep those of the rig")
    if len(frame) == 0 or not columns:
        raise BadInput(f"{shown}: holds no row; is it the right file?")
    return kind, tuple(columns), {}


_LINES = ("JSON lines", "read_ndjson")
_COUNTED_BYTES = 1 << 24


def _lines(polars: Any, path: Path) -> Any:
    """The frame of JSON lines. Kinds of columns are those of its first lines where these hold for all.

    Looking at every line for its kinds takes as long again as reading. The library raises where a number
    does not fit, but drops a key that the first lines lack: so all keys are counted.
    """
    try:
        frame = polars.read_ndjson(path)
        flat = not any(kind.is_nested() for kind in frame.dtypes)
        if flat and not sum(frame.null_count().row(0)) and _keys(path) == frame.width * frame.height:
            return frame
        del frame  # before the second one
    except polars.exceptions.ComputeError:
        pass  # a column is of one kind in the first lines, and of another later
    return polars.read_ndjson(path, infer_schema_length=None)


def _keys(path: Path) -> int:
    """How many keys there are, or more: a text may look like one."""
    count, last = 0, b""
    with path.open("rb") as file:
        while raw := file.read(_COUNTED_BYTES):
            count += (last + raw).count(b'":') + raw.count(b'" ')
            last = raw[-1:]
    return count


def _columns(polars: Any, series: Any, name: str) -> Iterator[Column]:
    """A column, or those inside of one that holds fields or short lists."""
    kind, unit = series.dtype, split_name(name)[1]
    if kind == polars.Struct:
        for part in series.struct.fields:
            yield from _columns(polars, series.struct.field(part), f"{name}.{part}")
    elif kind in (polars.List, polars.Array):
        lists = series.cast(polars.List(kind.inner))
        most = lists.list.len().max() or 0
        if most > MOST_SIDE:
            yield Column(name, "", np.empty(0), fault=f"holds lists of {most}, more than {MOST_SIDE}")
            return
        for k in range(most):
            yield from _columns(polars, lists.list.get(k, null_on_oob=True), f"{name}[{k + 1}]")
    elif kind.is_temporal():
        yield Column(name, "s", _seconds(polars, series))
    elif kind.is_numeric() or kind == polars.Boolean:
        values = series.cast(polars.Float64).to_numpy().astype(np.float64)
        fault = "" if np.isfinite(values).any() else "holds no number"
        yield Column(name, unit, np.where(np.isinf(values), math.nan, values), fault=fault)
    elif kind == polars.String or kind in (polars.Categorical, polars.Enum):
        texts = series.cast(polars.String)
        numbers = texts.str.strip_chars().cast(polars.Float64, strict=False)
        if numbers.null_count() == texts.null_count() < len(texts):
            yield Column(name, unit, numbers.to_numpy().astype(np.float64))
        else:
            words = np.array([(text or "").encode() for text in texts])
            yield words_column(name, unit, [words], "utf-8")
    else:
        yield Column(name, unit, np.empty(0), fault=f"holds {kind}, and no numbers")


def _seconds(polars: Any, series: Any) -> Any:
    """Seconds since 1970, of a time of day since midnight, of a duration as long as it is."""
    kind = series.dtype
    if kind == polars.Date:
        each_s = 86400.0
    else:
        each_s = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}[getattr(kind, "time_unit", "ns")]
    whole = series.to_physical()
    seconds = whole.fill_null(0).to_numpy() * each_s
    return np.where(whole.is_null().to_numpy(), math.nan, seconds)
