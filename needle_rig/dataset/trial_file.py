"""One trial from its CSV file: columns found by name and unit."""

from __future__ import annotations

import dataclasses
import difflib
import math
from pathlib import Path

import numpy as np

from needle_rig.config.hints import UNITS, split_unit
from needle_rig.config.places import show_path
from needle_rig.dataset.records import DatasetTrial, Start, TrialCommand
from needle_rig.dataset.samples import checked_trial
from needle_rig.dataset.table import Table, read_table
from needle_rig.errors import BadInput
from needle_rig.numerics import Array

_SI = {"time": 1.0, "angle": math.pi / 180.0, "torque": 1e-3}
TIP_TORQUE = "tip_torque"
_DEFAULT_UNIT = {"time": "s", "angle": "deg", "torque": "nmm"}


def read_trial(
    path: Path,
    folder: Path,
    sensors: tuple[str, ...],
    command: TrialCommand,
    start_s: float,
    start: Start = "relaxed",
) -> DatasetTrial:
    """The trial in the file at `path`, which must lie in `folder`.

    Raises BadInput with file and line, LeftOut when it has no use.
    """
    shown = show_path(path)
    table = read_table(path, folder, shown, "phase", "time")
    notes = list(table.notes)
    found = _columns(table, shown)
    time_s = _required(table, found, "time", "time", shown)
    base = _required(table, found, "base_angle", "angle", shown)
    torque = _measured(table, found, "base_torque", "torque", shown, notes)
    hall = [_measured(table, found, name, "angle", shown, notes) for name in sensors]
    if all(np.isnan(c).all() for c in (torque, *hall)):
        raise BadInput(
            f"{shown}:1: neither torque nor any Hall angle is recorded; there is nothing to compare"
        )
    tip = [_in_si(table, found, TIP_TORQUE, "torque", shown)] if TIP_TORQUE in found else []
    _name_unused(table, found, sensors, shown, notes)
    values = np.column_stack([time_s, base, torque, *hall, *tip])
    absent = {name for name in ("base_torque", *sensors) if name not in found}
    trial = checked_trial(
        values, table.text, table.line, sensors, shown, command, start_s, notes, absent, start
    )
    if "base_torque" not in found:
        return trial
    return dataclasses.replace(trial, torque_column=table.columns[found["base_torque"][0]])


def _columns(table: Table, shown: str) -> dict[str, tuple[int, str, str]]:
    """Column number, unit and dimension by the name without its unit."""
    found: dict[str, tuple[int, str, str]] = {}
    for number, column in enumerate(table.columns):
        stem, unit, dimension = split_unit(column)
        if not unit:
            stem = column
        if stem in found:
            raise BadInput(
                f"{shown}:1: {column} and {table.columns[found[stem][0]]} are the same quantity; keep one"
            )
        found[stem] = (number, unit, dimension)
    return found


def _required(
    table: Table, found: dict[str, tuple[int, str, str]], name: str, dimension: str, shown: str
) -> Array:
    if name not in found:
        wanted = f"{name}_{_DEFAULT_UNIT[dimension]}"
        near = difflib.get_close_matches(wanted, table.columns, 1, 0.6)
        hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(table.columns)}"
        raise BadInput(f"{shown}:1: column {wanted} is missing; {hint}")
    values = _in_si(table, found, name, dimension, shown)
    if not np.isfinite(values).any():
        raise BadInput(f"{shown}:2: {table.columns[found[name][0]]} has no values; the model is driven by it")
    return values


def _measured(
    table: Table,
    found: dict[str, tuple[int, str, str]],
    name: str,
    dimension: str,
    shown: str,
    notes: list[str],
) -> Array:
    """The channel in SI, all NaN when its column is missing (which is said)."""
    if name in found:
        return _in_si(table, found, name, dimension, shown)
    wanted = f"{name}_{_DEFAULT_UNIT[dimension]}"
    near = difflib.get_close_matches(wanted, table.columns, 1, 0.8)
    hint = f" (is it {near[0]}?)" if near else ""
    notes.append(f"{shown}:1: column {wanted} is missing{hint}; nothing is compared in this channel")
    return np.full(len(table.values), np.nan)


def _in_si(
    table: Table, found: dict[str, tuple[int, str, str]], name: str, dimension: str, shown: str
) -> Array:
    number, unit, given = found[name]
    if given != dimension:
        column = table.columns[number]
        unit_name = _DEFAULT_UNIT[dimension]
        raise BadInput(
            f"{shown}:1: {column}: its name ends in no unit of {dimension}; call it {name}_{unit_name}"
        )
    return table.values[:, number] * (UNITS[dimension][unit][0] * _SI[dimension])


def _name_unused(
    table: Table,
    found: dict[str, tuple[int, str, str]],
    sensors: tuple[str, ...],
    shown: str,
    notes: list[str],
) -> None:
    used = {"time", "base_angle", "base_torque", TIP_TORQUE, *sensors}
    extra = [table.columns[number] for stem, (number, _, _) in found.items() if stem not in used]
    if extra:
        notes.append(f"{shown}:1: not used, no sensor of the dataset has this name: {', '.join(extra)}")
