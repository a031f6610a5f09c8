"""The base's path without the encoder's noise.

Dry friction remembers every reversal: a 0.02° flicker of the encoder, fed to the model, would turn the
needle back and forth 50 times a second. A real drive holds still or goes one way, so holds become
constants and the strokes between turning points become monotone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from needle_rig.numerics import Array

TURN_SIGMA = 3.0
"""A reversal counts when the averaged path goes back by this many encoder noises."""
HOLD_S = 0.3
"""Shortest stretch that can be called a hold."""
AVERAGED_S = 0.12
"""Length over which the path is averaged to look for turning points."""
QUIET_SIGMA = 4.0
"""A slope below this many of its own standard errors is no motion."""
CLEAN_RAD = 2e-6
"""A path with less noise than this (0.0001°) is taken as it is."""
EDGE = 3
"""Samples at the ends of a hold that are left to the strokes: the first of a motion hide in the noise."""


@dataclass(frozen=True)
class BasePath:
    """The path that drives the model, and what was taken out of the measured one."""

    angle_rad: Array
    noise_rad: float
    """Standard deviation of the encoder's white noise, from third differences."""
    residual_rad: float
    """Root mean square of measured minus `angle_rad`."""
    holding: npt.NDArray[np.bool_]
    """True where the base holds still."""


def denoised_base(time_s: Array, measured_rad: Array) -> BasePath:
    """Holds made constant, strokes smoothed and made monotone. Arrays (samples,), all finite.

    A stretch is a hold when its slope stays within its standard error for 0.3 s and its local means agree
    with one constant; a slow drift therefore stays. Strokes are smoothed by a local cubic over seven samples
    (its bias is of fourth order in the sample time), then made monotone by isotonic regression between
    turning points. Reversals smaller than 3 encoder noises are lost in the noise.
    """
    n = len(time_s)
    noise = encoder_noise(measured_rad)
    if n < 8 or noise < CLEAN_RAD:
        still = np.concatenate(([True], np.diff(measured_rad) == 0.0))
        return BasePath(measured_rad.copy(), noise, 0.0, still)
    step = float(np.median(np.diff(time_s)))
    holds = _holds(measured_rad, noise, step)
    path = _local_cubic(measured_rad)
    holding = np.zeros(n, dtype=np.bool_)
    level: list[float] = []
    for start, stop in holds:
        # The tail of the approach is below the threshold of slope, not of its integral.
        settled = start + (stop - start) // 4 if start else start
        level.append(float(measured_rad[settled:stop].mean()))
        holding[start:stop] = True
    averaged = _averaged(measured_rad, max(3, round(AVERAGED_S / step)))
    ends = [0, *[edge for hold in holds for edge in hold], n]
    for (start, stop), value in zip(holds, level, strict=True):
        path[start:stop] = value
    for k in range(0, len(ends), 2):
        start, stop = ends[k], ends[k + 1]
        if stop <= start:
            continue
        before = level[k // 2 - 1] if k else None
        after = level[k // 2] if k // 2 < len(level) else None
        path[start:stop] = _monotone_strokes(
            path[start:stop], averaged[start:stop], before, after, TURN_SIGMA * noise
        )
    residual = float(np.sqrt(np.mean((measured_rad - path) ** 2)))
    return BasePath(path, noise, residual, holding)


def encoder_noise(measured_rad: Array) -> float:
    """Standard deviation of the white noise, at least that of the reading's steps; 0 for a clean path."""
    if len(measured_rad) < 8:
        return 0.0
    third = np.diff(measured_rad, 3)
    spread = 1.4826 * float(np.median(np.abs(third)))
    usual = third[np.abs(third) <= 3.5 * spread]
    spread = float(np.sqrt(np.mean(usual**2))) / math.sqrt(20.0) if len(usual) else 0.0
    moves = np.abs(np.diff(measured_rad))
    # Half of a clean path's third differences vanish in the holds; a flickering last digit shows itself
    # as many moves of the same smallest size.
    if spread > 1e-9:
        return spread
    moves = moves[moves > 1e-9]
    if not len(moves):
        return 0.0
    smallest = float(moves.min())
    flicker = np.count_nonzero(moves < 1.5 * smallest)
    return smallest / math.sqrt(12.0) if flicker > 0.2 * len(moves) and flicker > 20 else 0.0


def _holds(measured: Array, noise: float, step: float) -> list[tuple[int, int]]:
    """Bounds of the stretches in which the base stands still."""
    n = len(measured)
    width = min(max(7, round(HOLD_S / step) | 1), n)
    k = np.arange(width) - (width - 1) / 2.0
    weight = float((k**2).sum())
    slope = np.convolve(measured, k[::-1], mode="valid") / weight
    quiet_window = np.abs(slope) < QUIET_SIGMA * noise / np.sqrt(weight)
    quiet = np.zeros(n + 1, dtype=np.int64)
    starts = np.flatnonzero(quiet_window)
    np.add.at(quiet, starts, 1)
    np.add.at(quiet, starts + width, -1)
    still = np.cumsum(quiet)[:n] > 0
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.view(np.int8), [0]))))
    holds: list[tuple[int, int]] = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        holds.extend(_constant_parts(measured, int(start), int(stop), noise, width))
    return holds


def _constant_parts(
    measured: Array, start: int, stop: int, noise: float, width: int
) -> list[tuple[int, int]]:
    """The longest parts of a quiet stretch whose local means agree with one constant, ends trimmed."""
    while stop - start >= width:
        part = measured[start:stop]
        centre = float(np.median(part))
        blocks = max(1, (stop - start) // width)
        bounds = np.linspace(0, stop - start, blocks + 1).astype(int)
        means = np.array([part[a:b].mean() for a, b in pairwise(bounds.tolist())])
        sigma = noise / np.sqrt((stop - start) / blocks)
        bad = np.abs(means - centre) > 5.0 * sigma
        if not bad.any():
            # The window's reach takes in samples of the neighbouring stroke.
            near = np.abs(_averaged(part, 5) - centre) < 3.0 * noise / np.sqrt(5.0)
            good = np.flatnonzero(near)
            if not len(good):
                return []
            first = start + int(good[0]) + EDGE if start else 0
            last = start + int(good[-1]) + 1 - EDGE if stop < len(measured) else stop
            return [(first, last)] if last - first >= width // 2 else []
        if bad[0] and not bad.all():
            start += int(bounds[1])
        elif bad[-1] and not bad.all():
            stop = start + int(bounds[-2])
        else:
            return []
    return []


def _monotone_strokes(
    path: Array, averaged: Array, before: float | None, after: float | None, threshold: float
) -> Array:
    """`path` with every stroke between two turning points made monotone, joined to the holds beside it."""
    result = path.copy()
    turns = _turning_points(averaged, before, after, threshold)
    for start, stop in pairwise(turns):
        first = before if start == 0 and before is not None else averaged[start]
        last = after if stop == len(path) and after is not None else averaged[min(stop, len(path)) - 1]
        rising = last >= first
        stroke = isotonic(path[start:stop] if rising else -path[start:stop])
        stroke = stroke if rising else -stroke
        low = before if start == 0 and before is not None else None
        high = after if stop == len(path) and after is not None else None
        if not rising:
            low, high = high, low
        result[start:stop] = np.clip(
            stroke, -np.inf if low is None else low, np.inf if high is None else high
        )
    return result


def _turning_points(
    averaged: Array, before: float | None, after: float | None, threshold: float
) -> list[int]:
    """Places where the path turns by more than `threshold`, with both ends."""
    n = len(averaged)
    values = averaged.tolist()
    start = before if before is not None else values[0]
    low = high = start
    low_at = high_at = 0
    direction = 0
    turns = [0]
    tail = values if after is None else [*values, after]
    for i, value in enumerate(tail):
        if direction >= 0 and value > high:
            high, high_at = value, i
        if direction <= 0 and value < low:
            low, low_at = value, i
        if direction >= 0 and value < high - threshold:
            if direction > 0 or high - start > threshold:
                turns.append(high_at + 1)
            direction, low, low_at = -1, value, i
        elif direction <= 0 and value > low + threshold:
            if direction < 0 or start - low > threshold:
                turns.append(low_at + 1)
            direction, high, high_at = 1, value, i
    turns = [t for t in turns if t < n]
    return [*dict.fromkeys(turns), n]


def isotonic(values: Array) -> Array:
    """The non-decreasing sequence nearest to `values` (least squares, pool adjacent violators)."""
    from scipy.optimize import isotonic_regression

    return np.asarray(isotonic_regression(values).x, dtype=np.float64)


def _local_cubic(values: Array) -> Array:
    """Each sample replaced by the cubic fitted to it and its six neighbours (Savitzky and Golay 1964)."""
    if len(values) < 7:
        return values.copy()
    weights = np.array([-2.0, 3.0, 6.0, 7.0, 6.0, 3.0, -2.0]) / 21.0
    result = values.copy()
    result[3:-3] = np.convolve(values, weights, mode="valid")
    return result


def _averaged(values: Array, width: int) -> Array:
    """Running mean over `width` samples (odd), shorter at the ends."""
    half = width // 2
    total = np.concatenate(([0.0], np.cumsum(values - values[0])))
    place = np.arange(len(values))
    low = np.maximum(place - half, 0)
    high = np.minimum(place + half + 1, len(values))
    mean: Array = (total[high] - total[low]) / (high - low) + values[0]
    return mean
