"""MATLAB's objects that hold signals, by mat-io: tables, timeseries, and Datasets of Simulink."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.importing.arrays import Leaf

UNITS = ("VariableUnits", "varUnits")
"""What a table, and what a timetable calls the units of its columns."""
DEEPEST = 12
SIGNALS = ("timeseries", "table", "timetable", "Simulink.SimulationData.Signal")
"""Classes whose objects hold signals."""
_TIME_UNITS = {"seconds": "s", "milliseconds": "ms", "microseconds": "us", "minutes": "min", "hours": "h"}
"""Units of a timeseries' time, as MATLAB writes them."""


def signals_in(path: Path, shown: str) -> tuple[dict[str, Leaf], list[str]]:
    """Columns and times by name of the object that holds them, and objects that cannot be read.

    Raises BadInput.
    """
    matio = needed("matio", "an object of MATLAB", "import")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of objects that hold no signals
            content = matio.load_from_mat(str(path), add_table_attrs=True)
    except Exception as error:  # noqa: BLE001 - damaged files raise anything, down to struct's errors
        raise BadInput(
            f"{shown}: its objects cannot be read: {str(error)[:200]}; save them as arrays, with"
            " table2struct(…, 'ToScalar', true), or s.Time = ts.Time; s.Data = ts.Data"
        ) from None
    leaves: dict[str, Leaf] = {}
    lost: list[str] = []
    for name, value in content.items():
        _object(str(name), value, leaves, lost)
    return leaves, lost


def _object(name: str, value: Any, leaves: dict[str, Leaf], lost: list[str], depth: int = 0) -> None:
    """Adds the signals of `value`, and of what it holds, each below a name that no other has.

    Names of timeseries without numbers, and of objects without properties, as damage leaves them, are added
    to `lost`.
    """
    if depth > DEEPEST:
        return
    properties = _properties(value)
    if hasattr(value, "columns"):
        _table(_free(name, leaves), value, leaves)
    elif properties is not None and "TimeInfo" in properties:
        if not _timeseries(name.replace("/", "∕"), properties, leaves):
            lost.append(name)
    elif properties is None and getattr(value, "classname", "") in SIGNALS:
        lost.append(name)
    else:
        for key, part in _parts(value, properties):
            if (
                depth
                or properties is not None
                or hasattr(part, "classname")
                or isinstance(part, Mapping)
                or _properties(part) is not None
            ):
                _object(_called(part, name, key), part, leaves, lost, depth + 1)


def _properties(value: Any) -> Mapping[str, Any] | None:
    """Of an object by name, None of what is none."""
    found = getattr(value, "properties", None)
    if found is None and isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        found = getattr(value.reshape(-1)[0], "properties", None)
    return found if isinstance(found, Mapping) else None


def _parts(value: Any, properties: Mapping[str, Any] | None) -> Iterator[tuple[str, Any]]:
    """What an object, a cell or a struct holds, with the name of its place."""
    if properties is not None:
        yield from ((str(key), part) for key, part in properties.items())
    elif isinstance(value, np.ndarray) and value.dtype.names:
        for item in value.reshape(-1):
            yield from ((str(key), item[key]) for key in value.dtype.names)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        yield from ((str(k + 1), part) for k, part in enumerate(value.reshape(-1)))


def _called(part: Any, above: str, place: str) -> str:
    """How a part is called: by its own name, or else as that what holds it, or by its place."""
    properties = _properties(part)
    own = "" if properties is None else _text(properties.get("Name", ""))
    if own and own != "unnamed":
        return own
    is_object = properties is not None or hasattr(part, "classname")
    return above if is_object and not place.isdigit() else f"{above} {place}"


def _free(name: str, leaves: Mapping[str, Leaf]) -> str:
    name = name.replace("/", "∕")
    while any(path.startswith(f"{name}/") for path in leaves):
        name += "'"
    return name


def _table(name: str, frame: Any, leaves: dict[str, Leaf]) -> None:
    index = np.asarray(frame.index)
    if index.dtype.kind in "mM":
        leaves[f"{name}/{frame.index.name or 'Time'}"] = (index, "s")
    told: list[object] = next((list(frame.attrs[key]) for key in UNITS if key in frame.attrs), [])
    units = [str(unit) for unit in told] if len(told) == len(frame.columns) else [""] * len(frame.columns)
    for column, unit in zip(frame.columns, units, strict=True):
        leaves[f"{name}/{column}"] = (np.asarray(frame[column]), unit)


def _timeseries(name: str, properties: Mapping[str, Any], leaves: dict[str, Leaf]) -> bool:
    """Its times are numbers, or a start and a step where even; those of equal times are one table.

    False for one without numbers.
    """
    data = _numbers(properties, "Data_", "Data")
    if data is None:
        return False
    info = _properties(properties["TimeInfo"]) or {}
    times = _numbers(info, "Time_")
    if times is None:
        times = _numbers(properties, "Time_", "Time")
    step = _numbers(info, "Increment_")
    if times is None and step is not None:
        start = _numbers(info, "Start_")
        first = 0.0 if start is None else float(start.flat[0])
        times = first + float(step.flat[0]) * np.arange(max(np.squeeze(data).shape or (1,)))
    told = _text(info.get("Units", "")) or "seconds"
    group = _on_clock(times, _TIME_UNITS.get(told, told), leaves)
    while f"{group}/{name}" in leaves:
        name += "'"
    unit = (_properties(properties.get("DataInfo")) or {}).get("Units", "")
    leaves[f"{group}/{name}"] = (data, _text((_properties(unit) or {}).get("Name", unit)))
    return True


def _on_clock(times: np.ndarray | None, unit: str, leaves: dict[str, Leaf]) -> str:
    """The group of timeseries with these times, which it gets where it is new."""
    if times is None:
        return "timeseries without times"
    times = np.asarray(times, dtype=np.float64).reshape(-1)
    for path, (known, its_unit) in leaves.items():
        group, _, last = path.rpartition("/")
        alike = last == "Time" and group.startswith(_SERIES) and its_unit == unit
        if alike and known.shape == times.shape and np.allclose(known, times, rtol=0.0, atol=_SAME_S):
            return group
    group = _free(_SERIES, leaves)
    leaves[f"{group}/Time"] = (times, unit)
    return group


_SERIES = "timeseries"
_SAME_S = 1e-9
"""Start and step, and numbers, of the same times differ by their rounding."""


def _numbers(properties: Mapping[str, Any], *names: str) -> np.ndarray | None:
    """The first of these properties that holds finite numbers."""
    for name in names:
        value = np.asarray(properties.get(name, ()))
        if value.size and value.dtype.kind in "iufb" and np.isfinite(value).any():
            return value
    return None


def _text(value: Any) -> str:
    value = np.asarray(value)
    return str(value.reshape(-1)[0]).strip() if value.size == 1 and value.dtype.kind in "UO" else ""
