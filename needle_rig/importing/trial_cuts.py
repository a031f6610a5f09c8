"""Where a recording is cut into trials: at times, at a column, or at rests."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from needle_rig.dataset.base_path import denoised_base
from needle_rig.dataset.dominant_turns import arrival, dominant_turns
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
RELAXED_SENSOR_DEG, RELAXED_TORQUE, RELAXED_SIGMAS = 0.2, 0.02, 3.0
"""A shaft whose readings at a rest are within these of its first rest (a share of the torque's span, or so
many standard errors) is relaxed: less is within the noise of one sample."""
MEDIAN_TO_SIGMA, MEDIAN_VARIANCE = 1.4826, math.pi / 2.0
"""Standard deviation over median absolute deviation, variance of a median over that of a mean, of normal
samples."""


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
    to_si(si, parts, sensors, mapping.lever_mm)
    return at_rests(si[:, : 3 + len(sensors)])


def turns_before(si: Array, cuts: list[tuple[int, int]]) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """For each trial of a recording that began relaxed, the turns before it that friction remembers, rad, and
    how long before it the base came to each, s.

    None where every reading is as it was at first: the shaft is relaxed, or somebody let it go.
    """
    time_s = si[:, 0]
    known = np.isfinite(si[:, 1])
    base = denoised_base(time_s, np.interp(time_s, time_s[known], si[known, 1])).angle_rad
    moved = np.abs(base - base[0]) > math.radians(STILL_DEG)
    rest = slice(0, int(np.argmax(moved)) if moved.any() else len(base))
    found, since = [], 0
    for first, _ in cuts:
        around = np.abs(time_s - time_s[first]) <= 0.25 * REST_S
        if first == 0 or all(
            _alike(column[rest], column[around], RELAXED_TORQUE * _span(column) if k == 0 else None)
            for k, column in enumerate(si.T[2:])
        ):
            since = first
        path = base[since:first]
        places = dominant_turns(path)
        came_s = (float(time_s[first] - time_s[since + arrival(path, place)]) for place in places)
        found.append((tuple(float(path[place]) for place in places), tuple(came_s)))
    return found


def _alike(one: Array, other: Array, limit: float | None) -> bool:
    """Whether two stretches of a channel have one median, by their noise or a limit (default: an angle's).

    What has no reading is alike.
    """
    means, variances = [], []
    for values in (one, other):
        read = values[np.isfinite(values)]
        if not read.size:
            return True
        means.append(float(np.median(read)))
        spread = MEDIAN_TO_SIGMA * float(np.median(np.abs(read - means[-1])))
        variances.append(spread**2 * MEDIAN_VARIANCE / read.size)
    least = math.radians(RELAXED_SENSOR_DEG) if limit is None else limit
    return abs(means[1] - means[0]) <= max(RELAXED_SIGMAS * math.sqrt(sum(variances)), least)


def _span(column: Array) -> float:
    read = column[np.isfinite(column)]
    return float(np.ptp(read)) if read.size else 0.0


def at_rests(si: Array) -> tuple[list[tuple[int, int]], list[str]]:
    """Cuts in the middle of rests where the shaft is as it was at the start.

    Friction remembers: where the base came back and the shaft is still wound, the trial goes on.
    """
    time_s = si[:, 0]
    known = np.isfinite(si[:, 1])
    base = np.interp(time_s, time_s[known], si[known, 1])
    near = np.abs(base) <= math.radians(SAME_ANGLE_DEG)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], near.view(np.int8), [0]))))
    spans = np.array([_span(c) for c in si.T[2:]])
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
