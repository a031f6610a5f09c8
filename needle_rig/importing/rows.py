"""The rows of a dataset: one clock for channels that were sampled each in its own way."""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass

import numpy as np

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput
from needle_rig.importing.mapping import BASE, ClockPart
from needle_rig.importing.recording import Column, Recording
from needle_rig.importing.unit_text import unit_of
from needle_rig.numerics import Array

OVERLAP = 0.5
SLOWER = 1.5
"""A channel with this many times the dataset's step between samples keeps its own times."""


@dataclass(frozen=True)
class Channel:
    """One channel in SI on the recording's common clock."""

    role: str
    time_s: Array
    values: Array


def column_of(recording: Recording, name: str, place: str) -> Column:
    """The column of that name. Raises BadInput with the `place` in the mapping and what it may be."""
    column = recording.column(name)
    if column is None:
        names = [c.name for c in recording.columns]
        near = difflib.get_close_matches(name, names, 1, 0.6)
        hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(names[:12])}"
        raise BadInput(f"{place}: {show_path(recording.path)} has no column {name}; {hint}")
    if column.fault:
        raise BadInput(f"{place}: {show_path(recording.path)}: {name} cannot be used: {column.fault}")
    return column


def clock_times(recording: Recording, name: str, clock: ClockPart, number: int, rows: int) -> Array:
    """Times (rows,) of a clock in its n-th recording, s, its offset added. Raises BadInput."""
    offset_s = clock.files[number].offset_s
    if clock.source is None:
        assert clock.rate_hz is not None
        return np.arange(rows) / clock.rate_hz + offset_s
    column = column_of(recording, clock.source, f"clocks.{name}")
    if column.labels:
        raise BadInput(f"clocks.{name}: {clock.source} holds words; name a column of times, or write rate_hz")
    if len(column.values) != rows:
        raise BadInput(
            f"clocks.{name}: {clock.source} has {len(column.values)} rows, a channel on it {rows}; "
            "give that channel a clock of its own"
        )
    unit = unit_of(clock.unit or "")
    assert unit is not None
    return np.asarray(column.values * unit.si + offset_s, dtype=np.float64)


def row_times(channels: dict[str, Channel], rate_hz: float | None) -> Array:
    """Times of the rows: the base's samples or an even grid, and every sample of slower channels. Raises
    BadInput."""
    base = channels[BASE].time_s
    if rate_hz is not None and rate_hz * float(base[-1]) > len(base) + 1:
        raise BadInput(
            f"rate_hz: {rate_hz:g} Hz is more than the {len(base) / float(base[-1]):.4g} Hz of base_angle; "
            "write a smaller one, or leave it out"
        )
    rows = base if rate_hz is None else np.arange(0.0, float(base[-1]), 1.0 / rate_hz)
    step = float(np.median(np.diff(rows)))
    for channel in channels.values():
        own = float(np.median(np.diff(channel.time_s)))
        if own > SLOWER * step and channel.role != BASE:
            kept = channel.time_s[(channel.time_s >= rows[0]) & (channel.time_s <= rows[-1])]
            away = (
                np.abs(rows - kept[np.clip(np.searchsorted(kept, rows), 0, len(kept) - 1)])
                if len(kept)
                else None
            )
            if away is None:
                continue
            before = np.abs(rows - kept[np.clip(np.searchsorted(kept, rows) - 1, 0, len(kept) - 1)])
            rows = np.union1d(rows[np.minimum(away, before) > OVERLAP * step], kept)
    return rows


def at_rows(channel: Channel | None, rows_s: Array, base: Channel, rate_hz: float | None) -> Array:
    """At the rows: as sampled, averaged over a step, interpolated; NaN where a slow channel has none."""
    if channel is None:
        return np.full(len(rows_s), math.nan)
    time_s, values = channel.time_s, channel.values
    if len(time_s) == len(rows_s) and np.array_equal(time_s, rows_s):
        return values.copy()
    good = np.isfinite(values)
    time_s, values = time_s[good], values[good]
    if len(time_s) < 2:
        return np.full(len(rows_s), math.nan)
    own = float(np.median(np.diff(time_s)))
    step = 1.0 / rate_hz if rate_hz is not None else float(np.median(np.diff(base.time_s)))
    if own > SLOWER * step and channel.role != BASE:
        place = np.clip(np.searchsorted(time_s, rows_s), 0, len(time_s) - 1)
        return np.where(time_s[place] == rows_s, values[place], math.nan)
    first = np.searchsorted(time_s, rows_s - step / 2, side="left")
    last = np.searchsorted(time_s, rows_s + step / 2, side="right")
    total = np.concatenate(([0.0], np.cumsum(values - values[0])))
    many = last - first
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (total[last] - total[first]) / many + values[0]
    between = np.interp(rows_s, time_s, values, left=math.nan, right=math.nan)
    after = np.clip(np.searchsorted(time_s, rows_s), 1, len(time_s) - 1)
    wide = time_s[after] - time_s[after - 1] > 2.5 * max(own, step)
    between[wide] = math.nan
    return np.where(many >= 2, mean, between)
