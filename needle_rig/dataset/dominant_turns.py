"""What dry friction remembers of a path.

Of a path from a relaxed shaft it remembers the dominant turning points alone: one that is passed again is
forgotten (wiping-out property of Prandtl-Ishlinskii operators: Mayergoyz, Mathematical models of hysteresis,
1991, ch. 1).
"""

from __future__ import annotations

import numpy as np

from needle_rig.numerics import Array
from needle_rig.units import rad

SMALLEST_TURN_DEG = 0.1
"""Turns that the encoder's noise makes are none."""


def dominant_turns(path_rad: Array) -> list[int]:
    """Places of the turning points of a path from 0 that are not passed again; the last is its end."""
    if not path_rad.size:
        return []
    places = [_last_of_largest(np.abs(path_rad))]
    side = float(np.sign(path_rad[places[0]]))
    while places[-1] + 1 < path_rad.size:
        at = places[-1] + 1 + _last_of_largest(-side * path_rad[places[-1] + 1 :])
        if abs(path_rad[at] - path_rad[places[-1]]) < rad(SMALLEST_TURN_DEG):
            break
        places.append(at)
        side = -side
    return places


def arrival(path_rad: Array, place: int) -> int:
    """Since when a path has stood where it is at `place`, within `SMALLEST_TURN_DEG`."""
    elsewhere = np.abs(path_rad[:place] - path_rad[place]) > rad(SMALLEST_TURN_DEG)
    return int(np.flatnonzero(elsewhere)[-1]) + 1 if elsewhere.any() else 0


def _last_of_largest(values: Array) -> int:
    return len(values) - 1 - int(np.argmax(values[::-1]))
