"""HDF5 files of anybody, MATLAB's v7.3 among them: datasets, their attributes, compound tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from needle_rig.errors import BadInput
from needle_rig.importing.arrays import RATE_NAME, STEP_NAME, Leaf, columns_of, text_of
from needle_rig.importing.matlab import with_objects
from needle_rig.importing.recording import LIMIT_BYTES, Read

UNIT_ATTRIBUTES = ("units", "unit", "Units", "Unit", "UNITS", "UNIT", "unit_string")


def read_hdf5(path: Path, shown: str) -> Read:
    """The columns of an HDF5 file, with dialect and rates. Raises BadInput."""
    leaves: dict[str, Leaf] = {}
    matlab, objects = False, False
    try:
        with h5py.File(path, "r") as file:
            matlab = any("MATLAB_class" in item.attrs for item in file.values())
            objects = matlab and "#subsystem#" in file
            for key, value in file.attrs.items():
                _constant(leaves, "", key, value)
            size = [0]

            def visit(name: str, item: Any) -> None:
                if name.startswith(("#refs#", "#subsystem#")):
                    return
                for key, value in item.attrs.items():
                    _constant(leaves, name, key, value)
                if isinstance(item, h5py.Dataset):
                    size[0] += item.size * item.dtype.itemsize
                    if size[0] > LIMIT_BYTES:
                        raise BadInput(
                            f"{shown}: holds more than {LIMIT_BYTES / 1e9:g} GB once unpacked; keep what is "
                            "of the rig"
                        )
                    _leaf(leaves, name, item)

            file.visititems(visit)
    except BadInput:
        raise
    except Exception as error:  # noqa: BLE001 - the library hands on what filters and damaged bytes raise
        raise BadInput(
            f"{shown}: cannot be read as HDF5: {str(error)[:200]}; close it and copy it again"
        ) from None
    left = with_objects(leaves, path, shown) if objects else ()
    columns, rates = columns_of(leaves, shown)
    return ("MATLAB v7.3" if matlab else "HDF5"), (*columns, *left), rates


def _constant(leaves: dict[str, Leaf], place: str, key: str, value: Any) -> None:
    array = np.asarray(value)
    if (
        (RATE_NAME.fullmatch(key) or STEP_NAME.fullmatch(key))
        and array.size == 1
        and array.dtype.kind in "iuf"
    ):
        leaves[f"{place}/{key}".lstrip("/")] = (array, "")


def _leaf(leaves: dict[str, Leaf], name: str, item: Any) -> None:
    kind = text_of(item.attrs.get("MATLAB_class", b""))
    last = name.rpartition("/")[2]
    if (
        kind in ("char", "cell", "function_handle")
        or "MATLAB_object_decode" in item.attrs  # a reference to what an object holds elsewhere
        or last.lower() in ("unit", "units")
        or item.size == 0
    ):
        return
    if item.dtype.kind not in "iufbV" or item.ndim > 2:
        return
    unit = next((text_of(item.attrs[k]) for k in UNIT_ATTRIBUTES if k in item.attrs), "")
    if not unit and item.parent is not None:
        unit = _matlab_unit(item.parent, last)
    leaves[name] = (item[()], unit)


def _matlab_unit(group: Any, name: str) -> str:
    """A struct's field `units`: one text for all of it, or a struct with one for each name."""
    for key in ("units", "unit", "Units", "Unit"):
        told = group.get(key)
        if isinstance(told, h5py.Group):
            told = told.get(name)
        if isinstance(told, h5py.Dataset):
            if told.dtype.kind == "u" and text_of(told.attrs.get("MATLAB_class", b"")) == "char":
                return "".join(map(chr, told[()].ravel()))
            return text_of(told[()])
    return ""
