"""What effects of different machines take alike from the path of the base."""

from __future__ import annotations

import numpy as np

from needle_rig.numerics import Array


def after_play(base_rad: Array, play_rad: float, held_rad: float | None) -> Array:
    """What follows the base (samples,) over a play: it stays as near to where it was as half the play allows.

    It begins at `held_rad`, or centred where that is None. Source: the play operator, Brokate, Sprekels,
    "Hysteresis and phase transitions" (1996), ch. 2.
    """
    if base_rad.size == 0:
        return base_rad
    half_rad = play_rad / 2
    held = float(base_rad[0]) if held_rad is None else held_rad
    path = np.empty_like(base_rad)
    for i, base in enumerate(base_rad.tolist()):
        held = min(max(held, base - half_rad), base + half_rad)
        path[i] = held
    return path


def acceleration_rad_s2(time_s: Array, angle_rad: Array) -> Array:
    """Mean acceleration around each sample (samples,); the ends take their neighbour's.

    Between two samples the angle turns evenly: it is the change of the rate over half of both intervals.
    """
    if time_s.size < 3:
        return np.zeros_like(angle_rad)
    interval_s = np.diff(time_s)
    rate_rad_s = np.diff(angle_rad) / interval_s
    inside = np.diff(rate_rad_s) / (0.5 * (interval_s[1:] + interval_s[:-1]))
    return np.concatenate((inside[:1], inside, inside[-1:]))
