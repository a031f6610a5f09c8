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


def dominant_turns(path_rad: Array) -> list[float]:
    """Turning points of a path from 0 that are not passed again, in their order; the last is its end."""
    if not path_rad.size:
        return []
    at = _last_of_largest(np.abs(path_rad))
    turns, side = [float(path_rad[at])], float(np.sign(path_rad[at]))
    rest = path_rad[at + 1 :]
    while rest.size:
        at = _last_of_largest(-side * rest)
        if abs(rest[at] - turns[-1]) < rad(SMALLEST_TURN_DEG):
            break
        turns.append(float(rest[at]))
        rest, side = rest[at + 1 :], -side
    return turns


def _last_of_largest(values: Array) -> int:
    return len(values) - 1 - int(np.argmax(values[::-1]))
