"""Outliers among the samples of one channel, told by the median of their neighbours."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from needle_rig.dataset.samples import is_slow
from needle_rig.numerics import Array
from needle_rig.workbench.policy import POLICY

NEIGHBOURS = 5
"""Window of the median that outliers are compared with."""
MEDIAN_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
ALLOWANCE = 1.3
"""Factor on the limit of outliers, as the spread is that of one channel of one trial. Chosen."""


def set_aside(values: Array) -> tuple[Array, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """(values with holes and outliers filled in from their neighbours, valid, outlier) of one channel (M,).

    An outlier lies more than `noise.outlier_sigmas` robust standard deviations from the median of its
    neighbours; those of a channel with few samples are its own.
    """
    valid = np.isfinite(values)
    outlier = np.zeros(values.size, bool)
    if valid.sum() < NEIGHBOURS + 2:
        return np.where(valid, values, 0.0), valid, outlier
    where = np.arange(values.size)
    if is_slow(valid):
        own, kept, outlier[valid] = set_aside(values[valid])
        known = where[valid]
        valid[known[~kept]] = False
        return np.interp(where, known, own), valid, outlier
    filled = values if valid.all() else np.interp(where, where[valid], values[valid])
    # the ends mirrored; scipy.ndimage would take longer to import than this to run
    near = np.lib.stride_tricks.sliding_window_view(
        np.pad(filled, NEIGHBOURS // 2, mode="reflect"), NEIGHBOURS
    )
    middle = np.partition(near, NEIGHBOURS // 2, axis=1)[:, NEIGHBOURS // 2]
    away = np.abs(filled - middle)
    spread = MEDIAN_TO_SIGMA * np.median(away[away > 0]) if np.any(away > 0) else 0.0
    if spread > 0:
        outlier = valid & (away > POLICY.noise.outlier_sigmas * ALLOWANCE * spread)
        filled = np.where(outlier, middle, filled)
    return filled, valid & ~outlier, outlier
