"""Channels as a mapping understands them, for the picture to check: before anything is refused."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needle_rig.importing import signals
from needle_rig.importing.mapping import BASE, TORQUE, Mapping
from needle_rig.importing.reader import Recordings
from needle_rig.importing.unit_text import unit_of
from needle_rig.numerics import Array


@dataclass(frozen=True)
class Shown:
    """One channel of the first recording in the unit of its mapping, or as in the file without one."""

    role: str
    source: str
    unit: str
    time_s: Array
    values: Array


def preview(
    mapping: Mapping, folder: Path, recordings: Recordings
) -> tuple[list[Shown], tuple[Array, Array] | None]:
    """The channels of the first recording; base angle and torque at the base's times where both are there."""
    shown: list[Shown] = []
    for part in mapping.channels:
        clock = mapping.clocks[part.clock]
        file = clock.files[0]
        recording = recordings.read(folder / file.path, mapping.database(folder), file.table)
        column = recording.column(part.source)
        if column is None:
            continue
        time_s = np.arange(len(column.values)) / (clock.rate_hz or 1.0)
        source = None if clock.source is None else recording.column(clock.source)
        unit = unit_of(clock.unit or "")
        if source is not None and len(source.values) == len(time_s):
            time_s = source.values * (1.0 if unit is None else unit.si)
        zero = part.zero
        if zero == "start":
            zero = float(np.nanmean(column.values[: signals.rest_before_motion(column.values)]))
        values = part.sign * part.scale * (column.values - zero)
        shown.append(Shown(part.role, part.source, part.unit or "?", time_s + file.offset_s, values))
    begin = min((float(np.nanmin(s.time_s)) for s in shown), default=0.0)
    shown = [Shown(s.role, s.source, s.unit, s.time_s - begin, s.values) for s in shown]
    base = next((s for s in shown if s.role == BASE), None)
    torque = next((s for s in shown if s.role == TORQUE), None)
    if base is None or torque is None:
        return shown, None
    good = np.isfinite(torque.values) & np.isfinite(torque.time_s)
    return shown, (base.values, np.interp(base.time_s, torque.time_s[good], torque.values[good]))
