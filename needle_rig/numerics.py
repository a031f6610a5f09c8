"""Numerical methods that several rooms use."""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""Numbers of a computation: SI units and radians, of the shape that the docstring beside them gives."""


def rounded(value: float | None, decimals: int) -> float | None:
    """`value` for JSON, to so many `decimals`; None, JSON's null, where there is none or it is not finite."""
    return None if value is None or not math.isfinite(value) else round(value, decimals)


def beyond_chance(p: float, tried: int = 1) -> float:
    """What the largest size of so many standard normal values exceeds with probability `p` (Bonferroni)."""
    return -NormalDist().inv_cdf(p / 2.0 / max(1, tried))


def forward_jacobian(
    f: Callable[[Array], Array],
    x: Array,
    f_x: Array,
    step: float,
    low: Array | float = -np.inf,
    high: Array | float = np.inf,
) -> Array:
    """∂f/∂x at `x` (parameters,) by forward differences of one absolute `step`, shape (values, parameters).

    `f_x` is f(x), shape (values,). A step past `high` is taken backwards instead, and where the bounds, which
    are one for each parameter or one for all, leave room for neither, it ends at the farther one.
    """
    columns = []
    lowest, highest = np.broadcast_to(low, x.shape), np.broadcast_to(high, x.shape)
    for j, (above, below) in enumerate(zip(highest - x, x - lowest, strict=True)):
        moved = x.copy()
        if max(above, below) < step:
            moved[j] = highest[j] if above >= below else lowest[j]
        else:
            moved[j] += step if above >= step else -step
        columns.append((f(moved) - f_x) / (moved[j] - x[j]))
    return np.stack(columns, axis=-1)


def lower_root(covariance: Array) -> Array:
    """Lower triangular root (n, n) of a covariance (n, n), by Cholesky's method.

    Where one part is so large beside the others that rounding leaves none of these, each variance is taken to
    be larger by what rounding makes of it.
    """
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        deviation = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(deviation, deviation)
        correlation[np.diag_indices_from(correlation)] += deviation.size * np.finfo(np.float64).eps
        return np.asarray(deviation[:, None] * np.linalg.cholesky(correlation), dtype=np.float64)
