"""Derivatives by forward differences, within bounds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from needle_rig.numerics import Array


def directional_derivatives(
    values: Callable[[Array], Array | None],
    x: Array,
    here: Array,
    directions: Array,
    steps: Array,
    low: Array,
    high: Array,
    near: Callable[[Sequence[Array]], Sequence[Array | None]] = lambda points: [None] * len(points),
) -> Array | None:
    """Derivatives (n, m) of `values` ((P,) → (n,)) along `directions` (m, P), one step (m,) along each.

    `here` are the values at `x`; `near` gives those at several points to first order about it, None where it
    has none. A step goes the other way where it would leave `low` to `high` (P,), or where there are no
    values (None) at its end. None where there are none on either side.
    """
    moves = steps[:, None] * directions
    outside = np.any((x + moves > high) | (x + moves < low), axis=1)
    first = np.where(outside, -1.0, 1.0)
    columns = []
    linear = near([x + side * move for side, move in zip(first, moves, strict=True)])
    for move, length, side_first, known in zip(moves, steps, first, linear, strict=True):
        if known is not None:
            columns.append((known - here) / (side_first * length))
            continue
        for side in (side_first, -side_first):
            after = values(x + side * move)
            if after is not None:
                columns.append((after - here) / (side * length))
                break
        else:
            return None
    return np.column_stack(columns)
