"""What a run file must be made of before any of it is used: tables of known columns, plain attributes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from needle_rig.numerics import Array
from needle_rig.recording.tables import EVENT, run_tables

NOT_TABLES = frozenset({"events", "late_attributes"})
MEMBERS_LIMIT = 100
LONGEST_S = 1e9
"""The clock of a run counts from a computer's start; thirty years are none."""

_NEEDED: Mapping[str, tuple[str, ...]] = {
    "ticks": ("time_s", "phase", "motion", "base_angle_rad", "torque_nm", "hall_rad", "waypoint_rad"),
    "torque": ("time_s", "torque_nm"),
    "hall": ("time_s", "angle_rad"),
    "drive": ("time_s", "angle_rad"),
    "shaft": ("time_s", "angle_rad"),
}
"""Columns that readers of runs count on; files of other versions may have more and less beside them."""

_LINES = ("format", "strategy", "parameters", "rig", "kind", "started_utc")
_TEXTS = ("config", "versions", "options", "firmware")
_NUMBERS = ("target_deg", "speed_deg_s", "settle_s", "lag_left_deg")


def check_structure(file: h5py.File, size_bytes: int) -> None:
    """Raise ValueError, with a sentence, when the tables of `file` of `size_bytes` are not those of runs."""
    for name in file:
        if not isinstance(file.get(name, getlink=True), h5py.HardLink):
            raise ValueError(f"{name} is a link, perhaps into another file")
        _check_dataset(name, file[name], size_bytes)
    for name in NOT_TABLES - set(file):
        raise ValueError(f"it has no table {name}")


def check_plain(file: h5py.File, size_bytes: int) -> None:
    """Raise ValueError, with a sentence, when the attributes of `file` are not safe to read."""
    if len(file) > MEMBERS_LIMIT or len(file.attrs) > MEMBERS_LIMIT:
        raise ValueError(f"it has more than {MEMBERS_LIMIT} tables or attributes")
    for name in file.attrs:
        identity = file.attrs.get_id(name)
        shape = identity.shape
        plain = shape == () if identity.dtype.kind in "SO" else identity.dtype.kind in "fiub"
        # the library takes the memory that an attribute claims before it looks for the values
        if shape is None or not plain or math.prod(shape) * identity.dtype.itemsize > size_bytes:
            raise ValueError(f"attribute {name} is neither a text nor numbers")


def check_attributes(attributes: Mapping[str, Any]) -> None:
    """Raise ValueError, with a sentence, when an attribute that readers use is of another kind."""
    for name in (*_LINES, *_TEXTS):
        value = attributes.get(name, "")
        if not isinstance(value, str):
            raise ValueError(f"attribute {name} is no text")
        if name in _LINES and not value.isprintable():
            raise ValueError(f"attribute {name} has characters that cannot be shown")
    for name in _NUMBERS:
        value = attributes.get(name, 0.0)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"attribute {name} is no finite number")
    along = np.asarray(attributes.get("shaft_position_m", ()))
    if along.ndim != 1 or along.dtype.kind not in "fiu" or not np.isfinite(along).all():
        raise ValueError("attribute shaft_position_m is no list of numbers")


def check_times(name: str, time_s: Array) -> None:
    """Raise ValueError when a time of table `name` is none."""
    wrong = time_s[~(np.abs(time_s) < LONGEST_S)]
    if wrong.size:
        raise ValueError(f"table {name}: {wrong[0]:g} s is no time of a run")


def _filters(dataset: h5py.Dataset) -> set[int]:
    made = dataset.id.get_create_plist()
    return {made.get_filter(number)[0] for number in range(made.get_nfilters())}


def _check_dataset(name: str, dataset: Any, size_bytes: int) -> None:
    if not isinstance(dataset, h5py.Dataset) or dataset.ndim != 1:
        raise ValueError(f"{name} is no table")
    kind = dataset.dtype
    if dataset.is_virtual or dataset.external or _filters(dataset) - {h5py.h5z.FILTER_FLETCHER32}:
        raise ValueError(f"table {name} is compressed or lies in another file")
    if len(dataset) * kind.itemsize > size_bytes:
        raise ValueError(f"table {name} claims {len(dataset)} rows of {kind.itemsize} bytes")
    if name == "late_attributes":
        if kind != np.dtype("u1"):
            raise ValueError(f"table {name} is of another type")
        return
    if name == "events" and kind != EVENT:
        raise ValueError(f"table {name} is of another type")
    columns = {column: kind[column] for column in kind.names or ()}
    expected = run_tables(sensors=1, shaft_nodes=1).get(name)
    for column in _NEEDED.get(name, ("time_s",)):
        if column not in columns:
            raise ValueError(f"table {name} has no column {column}")
    for column, found in columns.items():
        known = expected[column] if expected is not None and column in (expected.names or ()) else None
        if found.base.kind not in "fiubS" or len(found.shape) > 1:
            raise ValueError(f"table {name}: column {column} is neither numbers nor text")
        if known is not None and (found.base.kind, len(found.shape)) != (known.base.kind, len(known.shape)):
            raise ValueError(f"table {name}: column {column} is of another type")
    if columns["time_s"].kind != "f" or columns["time_s"].shape:
        raise ValueError(f"table {name}: column time_s is no time")
