"""Where a recording is cut into trials: at times, at a column, or at rests."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.importing.mapping import ChannelPart, Mapping
from needle_rig.importing.recording import Recording
from needle_rig.importing.rows import clock_times, column_of
from needle_rig.importing.si import to_si
from needle_rig.numerics import Array

REST_S = 1.0
"""Shortest rest between trials; holds inside of one are as long, but not at the start's angle and torque."""
STILL_DEG = 0.3
"""Span of a base at rest, by noise and creep; one that passes by at 1°/s shows more."""
SAME_ANGLE_DEG = 1.0
"""Distance from the start's angle that counts as the same, as `AT_REST_DEG` of datasets."""
SAME_TORQUE = 0.1
"""Share of the torque's span: a shaft that bears more is wound, and its trial goes on."""
SAME_SENSOR_DEG = 3.0
"""A sensor that stands farther from where it began is on a wound needle; as `WOUND_DEG` of datasets."""


def cuts_of(
    mapping: Mapping,
    table: Array,
    of: dict[str, Recording],
    zero_s: float,
    number: int,
    parts: dict[str, ChannelPart],
    sensors: tuple[str, ...],
) -> tuple[list[tuple[int, int]], list[str]]:
    """First and end row of each trial."""
    how = mapping.trials
    rows_s = table[:, 0]
    if how.at == "whole":
        return [(0, len(rows_s))], []
    if how.at == "times":
        cuts = [(int(np.searchsorted(rows_s, a)), int(np.searchsorted(rows_s, b))) for a, b in how.times_s]
        empty = next((k for k, (a, b) in enumerate(cuts) if b - a < 2), None)
        if empty is not None:
            a, b = how.times_s[empty]
            raise BadInput(
                f"trials.times_s[{empty}]: {a:g} to {b:g} s lies outside of the recording, which is "
                f"{rows_s[-1]:.4g} s long"
            )
        return cuts, []
    if how.at == "column":
        assert how.clock is not None
        assert how.source is not None
        column = column_of(of[how.clock], how.source, "trials")
        times = (
            clock_times(of[how.clock], how.clock, mapping.clocks[how.clock], number, len(column.values))
            - zero_s
        )
        known = np.isfinite(column.values) & np.isfinite(times)
        place = np.clip(np.searchsorted(times[known], rows_s, side="right") - 1, 0, None)
        value = column.values[known][place]
        edges = [0, *(np.flatnonzero(np.diff(value)) + 1).tolist(), len(rows_s)]
        return list(pairwise(edges)), []
    si = table.copy()
    to_si(si, parts, sensors)
    return at_rests(si)


def at_rests(si: Array) -> tuple[list[tuple[int, int]], list[str]]:
    """Cuts in the middle of rests where the shaft is as it was at the start.

    Friction remembers: where the base came back and the shaft is still wound, the trial goes on.
    """
    time_s = si[:, 0]
    known = np.isfinite(si[:, 1])
    base = np.interp(time_s, time_s[known], si[known, 1])
    near = np.abs(base) <= math.radians(SAME_ANGLE_DEG)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], near.view(np.int8), [0]))))
    spans = np.array([np.ptp(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in si.T[2:]])
    cuts, wound = [0], 0
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        inside = slice(start + (stop - start) // 4, stop - (stop - start) // 4)
        moves = math.degrees(float(np.ptp(base[inside]))) > STILL_DEG
        if start == 0 or stop == len(time_s) or moves or time_s[stop - 1] - time_s[start] < REST_S:
            continue
        now = [float(np.median(c[np.isfinite(c)])) if np.isfinite(c).any() else 0.0 for c in si[inside, 2:].T]
        limits = [SAME_TORQUE * spans[0], *([math.radians(SAME_SENSOR_DEG)] * (len(now) - 1))]
        if any(abs(v) > limit for v, limit in zip(now, limits, strict=True) if limit > 0):
            wound += 1
        else:
            cuts.append((start + stop) // 2)
    notes = []
    if wound:
        notes.append(
            f"{wound} rests at the start's angle find the shaft wound; the recording is not cut there, "
            "since friction remembers the way"
        )
    cuts.append(len(time_s))
    return list(pairwise(cuts)), notes
