"""What a run file holds: the tables of its sources and the attributes that describe it."""

from __future__ import annotations

import datetime
import json
import platform
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import numpy.typing as npt

from needle_rig.config.file_kinds import judge_format
from needle_rig.config.loader import rig_config_text
from needle_rig.config.places import Places
from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.records import JsonObject, Sample
from needle_rig.units import deg, nmm
from needle_rig.version import VERSION

Rows = npt.NDArray[Any]
"""Rows of one table of a run: a structured array whose fields are those of `run_tables`, or EVENT."""

FORMAT = "needle-rig-run/1"

EVENT = np.dtype([("time_s", "f8"), ("kind", "S24"), ("text", "S480")])
"""One event; text longer than its field goes on in the next row, marked by an empty kind."""


def judge_run(attributes: JsonObject, shown: str) -> None:
    """Raise BadInput unless `attributes` (`format`, `versions`) are of a run that can be read."""
    form = attributes.get("format")
    if not (isinstance(form, str) and form.startswith(FORMAT.partition("/")[0] + "/")):
        raise BadInput(f"{shown}: is HDF5 but no run of needle-rig (no attribute format: {FORMAT})")
    judge_format(attributes, Places(shown), FORMAT, writer=_writer(attributes))


def _writer(attributes: JsonObject) -> str | None:
    """The version of needle-rig that recorded a run, where it can be read."""
    with suppress(ValueError):
        versions = json.loads(str(attributes.get("versions")))
        if isinstance(versions, dict) and str(versions.get("needle-rig", "")).isprintable():
            return versions.get("needle-rig")
    return None


_EDGE_UNITS: tuple[tuple[str, str, Callable[[Array], Array], int], ...] = (
    ("_rad_s", "_deg_s", deg, 4),
    ("_rad", "_deg", deg, 4),
    ("_nm", "_nmm", nmm, 6),
)


def at_edge(field: str) -> tuple[str, Callable[[Array], Array], int]:
    """How files show a field: name with its unit there, conversion, decimals (`hall_rad` → `hall_deg`)."""
    for inside, outside, convert, decimals in _EDGE_UNITS:
        if field.endswith(inside):
            return field.removesuffix(inside) + outside, convert, decimals
    return field, lambda values: values, 6


def edge_values(rows: Rows, begin_s: float = 0.0) -> Iterator[tuple[str, npt.NDArray[Any], int]]:
    """Columns of a table as files show them: name, values, decimals; arrays become one column an entry.

    `hall_rad` becomes `hall_1_deg` and so on; `time_s` counts from `begin_s`.
    """
    for name in rows.dtype.names or ():
        values = rows[name]
        shown, convert, decimals = at_edge(name)
        values = values - begin_s if name == "time_s" else convert(values)
        if values.ndim == 1:
            yield shown, values, decimals
            continue
        stem, unit = shown.rsplit("_", 1)
        for index in range(values.shape[1]):
            yield f"{stem}_{index + 1}_{unit}", values[:, index], decimals


def run_tables(sensors: int, shaft_nodes: int = 0) -> dict[str, np.dtype[Any]]:
    """The tables of a run: ticks (one row a Sample), the raw readings, and shaft pictures if any.

    `sensors` is the number of Hall sensors; `shaft_nodes` the number of nodes that a simulated rig shows.
    Field names carry units; time_s is the daemon's monotonic clock in every table.
    """
    tables: dict[str, list[tuple[Any, ...]]] = {
        "ticks": [
            ("time_s", "f8"),
            ("dt_s", "f8"),
            ("phase", "S12"),
            ("motion", "S24"),
            ("base_angle_rad", "f8"),
            ("torque_nm", "f8"),
            ("hall_rad", "f8", (sensors,)),
            ("waypoint_rad", "f8"),
            ("velocity_rad_s", "f8"),
            ("enable", "?"),
            ("limited", "?"),
            ("drive_state", "u1"),
            ("drive_faults", "u2"),
            ("torque_age_s", "f8"),
            ("hall_age_s", "f8"),
            ("drive_age_s", "f8"),
        ],
        "torque": [("time_s", "f8"), ("node_time_s", "f8"), ("counter", "u4"), ("torque_nm", "f8")],
        "hall": [
            ("time_s", "f8"),
            ("node_time_s", "f8"),
            ("counter", "u4"),
            ("angle_rad", "f8", (sensors,)),
        ],
        "drive": [
            ("time_s", "f8"),
            ("node_time_s", "f8"),
            ("counter", "u4"),
            ("angle_rad", "f8"),
            ("state", "u1"),
            ("faults", "u2"),
        ],
    }
    if shaft_nodes:
        tables["shaft"] = [("time_s", "f8"), ("angle_rad", "f8", (shaft_nodes,))]
    return {name: np.dtype(fields) for name, fields in tables.items()}


def sample_row(sample: Sample) -> tuple[Any, ...]:
    """`sample` as a row of the table ticks."""
    return (
        sample.time_s,
        sample.dt_s,
        sample.phase.value.encode(),
        sample.motion.encode(),
        sample.base_angle_rad,
        sample.torque_nm,
        sample.hall_rad,
        sample.waypoint_rad,
        sample.velocity_rad_s,
        sample.enable,
        sample.limited,
        int(sample.drive_state),
        int(sample.drive_faults),
        sample.torque_age_s,
        sample.hall_age_s,
        sample.drive_age_s,
    )


def run_attributes(
    config: RigConfig, *, strategy: str, target_deg: float, parameters: str, **more: Any
) -> JsonObject:
    """What every run says of itself: the request, the whole effective config, versions and the start.

    `parameters` names the simulated needle, or is empty on hardware; `more` are text, numbers or arrays, and
    stand in for what the config says.
    """
    return {
        "strategy": strategy,
        "target_deg": float(target_deg),
        "parameters": parameters,
        "rig": config.name,
        "kind": config.kind,
        "config": rig_config_text(config),
        "versions": json.dumps(_versions()),
        "started_utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds"),
        **more,
    }


def _versions() -> Mapping[str, str]:
    found = {"needle-rig": VERSION, "python": platform.python_version(), "linux": platform.release()}
    for package in ("numpy", "scipy", "numba", "h5py", "python-can", "pyserial", "simple-pid", "cantools"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    return found
