"""MATLAB files: v5 to v7.2 by scipy; v7.3, which is HDF5, by `hdf5`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.importing.arrays import FEWEST_ROWS, Leaf, columns_of, text_of
from needle_rig.importing.recording import Column, Read

UNIT_FIELDS = ("unit", "units", "Unit", "Units")
DEEPEST = 12


def read_matlab(path: Path, shown: str) -> Read:
    """Dialect in words, columns and rates of a file of version 5 to 7.2. Raises BadInput."""
    import scipy.io

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # objects have no names there
            content = scipy.io.loadmat(str(path), simplify_cells=True)
    except Exception as error:  # noqa: BLE001 - damaged files raise anything, down to zlib's and struct's errors
        raise BadInput(
            f"{shown}: cannot be read as a MATLAB file: {str(error)[:200]}; save it again"
        ) from None
    objects = "__function_workspace__" in content  # where they are kept, at whatever depth they are named
    opaque = [k for k, v in content.items() if type(v).__name__ == "MatlabOpaque"]
    leaves: dict[str, Leaf] = {}
    flatten({k: v for k, v in content.items() if not k.startswith("__") and k not in opaque}, "", leaves)
    left = with_objects(leaves, path, shown) if objects else ()
    columns, rates = columns_of(leaves, shown)
    return "MATLAB v5", (*columns, *left), rates


def with_objects(leaves: dict[str, Leaf], path: Path, shown: str) -> tuple[Column, ...]:
    """Adds the signals of a file's objects to its arrays; what cannot be read is a column with a fault.

    Raises BadInput where there is nothing but objects that hold no signals.
    """
    from needle_rig.importing.matlab_objects import signals_in

    try:
        found, lost = signals_in(path, shown)
    except BadInput as error:
        if not any(array.size >= FEWEST_ROWS for array, _ in leaves.values()):
            raise
        return (Column("objects of MATLAB", "", np.empty(0), fault=str(error).removeprefix(f"{shown}: ")),)
    if not found and not leaves and not lost:
        raise BadInput(
            f"{shown}: holds objects of MATLAB that are no table, timeseries or Dataset; save arrays, with"
            " s.Time = ts.Time; s.Data = ts.Data"
        )
    leaves |= found
    return tuple(Column(name, "", np.empty(0), fault=_LOST) for name in lost)


_LOST = "holds no numbers that can be read, as where a file is damaged; save it again"


def flatten(node: Any, path: str, leaves: dict[str, Leaf], unit: str = "", depth: int = 0) -> None:
    """Arrays below `node` by path; units from a field `units` beside them, one text or one for each name."""
    if depth > DEEPEST:
        return
    if isinstance(node, Mapping):
        told = next((node[k] for k in UNIT_FIELDS if k in node), "")
        for key, value in node.items():
            if key in UNIT_FIELDS:
                continue
            own = text_of(told.get(key, "")) if isinstance(told, Mapping) else text_of(told)
            flatten(value, f"{path}/{key}" if path else str(key), leaves, own or unit, depth + 1)
    elif isinstance(node, list) or (isinstance(node, np.ndarray) and node.dtype == object):
        for k, item in enumerate(node):
            label = text_of(item.get("label", item.get("name", ""))) if isinstance(item, Mapping) else ""
            flatten(item, f"{path}/{label or k + 1}", leaves, unit, depth + 1)
    elif isinstance(node, np.ndarray | int | float | np.number) and not isinstance(node, bool):
        leaves[path] = (np.asarray(node), unit)
