"""What can be wrong with a recorded channel: its unit, wraps, a dead sensor, outliers left alone."""

from __future__ import annotations

import math

import numpy as np

from needle_rig.numerics import Array

FULL_TURN_RAD = 2.0 * math.pi


def unwrapped(angle_rad: Array) -> tuple[Array, int | None]:
    """The angle without jumps by a whole turn, and the place of the first jump (None without one).

    Only steps within 60° of a turn are taken for wraps: a single outlier stays what it is, and so does a way
    of several turns between two samples. A reading that wraps lies within one turn.
    """
    known = np.flatnonzero(np.isfinite(angle_rad))
    if len(known) < 2:
        return angle_rad, None
    steps = np.diff(angle_rad[known])
    turns = np.round(steps / FULL_TURN_RAD)
    turns[(np.abs(turns) > 1.0) | (np.abs(steps - turns * FULL_TURN_RAD) > math.radians(60))] = 0.0
    if not turns.any():
        return angle_rad, None
    result = angle_rad.copy()
    result[known[1:]] -= np.cumsum(turns) * FULL_TURN_RAD
    return result, int(known[1:][np.flatnonzero(turns)[0]])


def stuck_runs(values: Array, time_s: Array) -> list[tuple[int, int]]:
    """Bounds of the stretches in which a reading repeats longer than its own noise allows.

    A run counts from half a second and 25 samples on, when it is longer than chance makes one for the share
    of repeats in the rest of the channel. A channel without noise (all runs) has none.
    """
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 30:
        return []
    same = np.diff(values[known]) == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate(([0], same.view(np.int8), [0]))))
    runs = [
        (int(a), int(b))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if b - a >= 25 and time_s[known[b]] - time_s[known[a]] >= 0.5
    ]
    if not runs:
        return []
    inside = np.zeros(len(same), dtype=np.bool_)
    for a, b in runs:
        inside[a:b] = True
    rest = same[~inside]
    if len(rest) < 10:
        return []
    share = min(max(rest.mean(), 1e-3), 0.999)
    chance = 10.0 + 3.0 * math.log(len(same)) / math.log(1.0 / share)
    return [(int(known[a]), int(known[b]) + 1) for a, b in runs if b - a > chance]


def white_noise(values: Array) -> float:
    """Standard deviation of the white part, from third differences; 0 when it is unknown."""
    known = values[np.isfinite(values)]
    if len(known) < 8:
        return 0.0
    return 1.4826 * float(np.median(np.abs(np.diff(known, 3)))) / math.sqrt(20.0)


def suspected_factor(seen: float, expected: float, factor: float, within: float) -> bool:
    """Whether `seen` is `expected` written in a unit `factor` times larger."""
    if expected <= 0.0 or seen <= 0.0:
        return False
    return abs(math.log(seen * factor / expected)) < math.log(within)
