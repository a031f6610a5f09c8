"""Derivatives by forward differences, within bounds."""

from __future__ import annotations

from collections.abc import Callable

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
) -> Array | None:
    """Derivatives (n, m) of `values` ((P,) → (n,)) along `directions` (m, P), one step (m,) along each.

    `here` are the values at `x`. A step goes the other way where it would leave `low` to `high` (P,), or
    where there are no values (None) at its end. None where there are none on either side.
    """
    columns = []
    for direction, length in zip(directions, steps, strict=True):
        step = length * direction
        outside = np.any(x + step > high) or np.any(x + step < low)
        for side in (-1.0, 1.0) if outside else (1.0, -1.0):
            after = values(x + side * step)
            if after is not None:
                columns.append((after - here) / (side * length))
                break
        else:
            return None
    return np.column_stack(columns)
