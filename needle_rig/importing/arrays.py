"""Arrays in a tree (MATLAB, HDF5, NumPy) to columns: those of one length in one place are one table."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.importing import names
from needle_rig.importing.header import unique
from needle_rig.importing.recording import MAX_COLUMNS, Column
from needle_rig.importing.unit_text import split_name

FEWEST_ROWS = 10
"""As in datasets; shorter arrays are constants."""
MOST_SIDE = 64
"""Columns of one two-dimensional array; an image has more."""
RATE_NAME = re.compile(
    r"(fs|rate|freq|sampl\w*_?(rate|freq\w*)|f_?sampl\w*|rate_hz|fs_hz|sampl\w*rate)", re.IGNORECASE
)
NUMBERS_OF = re.compile(r"/(values?|data)$", re.IGNORECASE)
"""A field that holds the numbers of what is named before it, as Simulink and timeseries write it."""
STEP_NAME = re.compile(r"(dt|ts|delta_?t|sampl\w*_?(time|period|interval)|dt_s)", re.IGNORECASE)

Leaf = tuple[np.ndarray, str]
"""An array and its unit as written."""


def columns_of(leaves: Mapping[str, Leaf], shown: str) -> tuple[tuple[Column, ...], dict[str, float]]:
    """Columns and rates of arrays by path ("daq/torque"). Raises BadInput when there is no long array.

    A group with a time of its own is a table; what has none is on a clock with all arrays of its length.
    """
    found: list[tuple[str, str, str, np.ndarray]] = []
    left: dict[str, str] = {}
    constants: dict[str, float] = {}
    for path, (array, unit) in leaves.items():
        values = np.squeeze(np.asarray(array))
        parent = path.rpartition("/")[0]
        if values.size == 1 and values.dtype.kind in "iuf":
            constants[path] = float(values.reshape(()))
        elif values.dtype.names:
            found += [(f"{path}/{n}", "", path, values[n]) for n in values.dtype.names if values[n].ndim == 1]
        elif values.dtype.kind in "mM" and values.ndim == 1:
            seconds = values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64) * 1e-9
            found.append((path, "s", parent, seconds))
        elif values.dtype.kind in "OUS":
            left[path] = "holds words, no numbers"
        elif values.dtype.kind not in "iufb" or values.ndim not in (1, 2):
            left[path] = f"an array of {values.dtype} with {values.ndim} dimensions, and no column of numbers"
        elif values.ndim == 1:
            found.append((path, unit, parent, values))
        elif min(values.shape) <= MOST_SIDE:
            rows = values if values.shape[0] >= values.shape[1] else values.T
            found += [(f"{path}.{k + 1}", unit, parent, rows[:, k]) for k in range(rows.shape[1])]
        else:
            left[path] = f"a table of {' × '.join(map(str, values.shape))}, more than {MOST_SIDE} columns"
    for path, _, _, values in found:
        if len(values) < FEWEST_ROWS or values.dtype.kind not in "iufb":
            left[path] = f"has {len(values)} rows, fewer than {FEWEST_ROWS}, or no numbers"
    found = [entry for entry in found if len(entry[3]) >= FEWEST_ROWS and entry[3].dtype.kind in "iufb"]
    if not found:
        raise BadInput(f"{shown}: holds no array of {FEWEST_ROWS} numbers or more; is it the right file?")
    if len(found) > MAX_COLUMNS:
        raise BadInput(f"{shown}: {len(found)} arrays, more than {MAX_COLUMNS}; keep those of the rig")
    common = _common(["/".join(path.split("/")[:-1]) for path, *_ in found])
    shown_names = unique([path[len(common) :].lstrip("/") for path, *_ in found])
    lengths = {parent: {len(v) for _, _, p, v in found if p == parent} for _, _, parent, _ in found}
    many = Counter(parent for _, _, parent, _ in found)
    timed = {parent for path, _, parent, _ in found if names.says(path.rpartition("/")[2], names.TIME)}
    columns: list[Column] = []
    rates: dict[str, float] = {}
    for name, (_, unit, parent, array) in zip(shown_names, found, strict=True):
        own = parent in timed and len(lengths[parent]) == 1 and many[parent] > 1
        table = parent[len(common) :].lstrip("/") if own else f"{len(array)} rows"
        values = np.asarray(array, dtype=np.float64)
        if np.isinf(values).any():
            values = np.where(np.isinf(values), np.nan, values)
        columns.append(Column(name, unit or split_name(NUMBERS_OF.sub("", name))[1], values, table))
        rate_hz = _rate_hz(constants, parent)
        if rate_hz is not None:
            rates.setdefault(table, rate_hz)
    for path, fault in left.items():
        name = path.removeprefix(f"{common}/")
        columns.append(Column(name, leaves[path][1] if path in leaves else "", np.empty(0), fault=fault))
    return tuple(columns), rates


def _common(parents: list[str]) -> str:
    """The folder that all lie in."""
    parts = [p.split("/") for p in parents]
    shared = []
    for level in zip(*parts, strict=False):
        if len(set(level)) > 1:
            break
        shared.append(level[0])
    return "/".join(shared)


def _rate_hz(constants: Mapping[str, float], parent: str) -> float | None:
    """Samples a second from a constant beside the arrays, or above them."""
    while True:
        for path, value in constants.items():
            folder, _, name = path.rpartition("/")
            if folder == parent and value > 0 and np.isfinite(value):
                stem, _ = split_name(name)
                if RATE_NAME.fullmatch(stem) or RATE_NAME.fullmatch(name):
                    return value
                if STEP_NAME.fullmatch(name):
                    return 1.0 / value
        if not parent:
            return None
        parent = parent.rpartition("/")[0]


def text_of(value: Any) -> str:
    """A unit written as bytes, text or an array of one; empty for anything else."""
    value = value.reshape(-1)[0] if isinstance(value, np.ndarray) and value.size == 1 else value
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace").strip("\0 ")
    return value.strip() if isinstance(value, str) else ""
