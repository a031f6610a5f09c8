"""Outliers that a model alone tells: while the base moves.

On a ramp the median of a sample's neighbours lies between them wherever the sample does, and the mean of a
bin of few samples goes with an outlier in it. Beside a fit such a bin stands out, alone among its neighbours.
What a model lacks may look so too; bins are left out only in a channel of which medians told outliers, and no
more of them than its share of these lets expect.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
from scipy.special import pdtrc

from needle_rig.workbench.estimation.baseline import Baseline, over_trials
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.noise import covariance
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.explanation import channel_names

Bins = npt.NDArray[np.bool_]
"""Of all channels of a trial, (C, K)."""


def without_outliers(baseline: Baseline, problem: Problem, found: Fit) -> tuple[Baseline, str] | None:
    """The baseline without the bins that `found` shows to hold an outlier, and a note; None without such."""
    outliers = outlying_bins(problem, found)
    number = sum(bins.sum(axis=1) for bins in outliers)
    if not np.any(number):
        return None
    without = over_trials(baseline, [_left_out(b, o) for b, o in zip(problem.trials, outliers, strict=True)])
    if without is baseline:
        return None
    names = channel_names(baseline.dataset)
    told = " and ".join(f"{n} of {name}" for n, name in zip(number, names, strict=True) if n)
    limit = POLICY.noise.outlier_sigmas
    return without, (
        f"Left out as outliers: means of readings while the base moved, {told}. Each is more than {limit:g} σ"
        " from what is named here, alone among its neighbours, and they are no more than the channel's share"
        " of outliers at rest lets expect."
    )


def outlying_bins(problem: Problem, found: Fit) -> list[Bins]:
    """Bins (C, K) of each trial that hold an outlier beside `found`.

    None of a channel of which they are more than its share of outliers elsewhere lets expect.
    """
    outliers = [np.zeros(b.mean.shape, bool) for b in problem.trials]
    left = problem.raw(found.residuals)
    for c in range(len(problem.noise.white)):
        known = sum(b.outliers[c] for b in problem.trials)
        read = known + sum(float(b.count[c].sum()) for b in problem.trials)
        samples = 0.0
        for binned, raw, mine in zip(problem.trials, left, outliers, strict=True):
            use, stated = covariance(problem.noise, binned, c)
            size = np.abs(raw[c][use]) / np.sqrt(np.diag(stated))
            beside = np.maximum(np.r_[0.0, size[:-1]], np.r_[size[1:], 0.0])
            moving = binned.moving[use]
            alone = size > np.maximum(POLICY.noise.outlier_sigmas, POLICY.noise.outlier_alone * beside)
            mine[c, use] = moving & alone
            samples += float(binned.count[c, use[moving]].sum())
        number = sum(int(mine[c].sum()) for mine in outliers)
        if number and pdtrc(number - 1, samples * known / read) < POLICY.noise.outlier_chance:
            for mine in outliers:
                mine[c] = False
    return outliers


def _left_out(binned: BinnedTrial, outliers: Bins) -> BinnedTrial:
    more = outliers.sum(axis=1)
    return dataclasses.replace(
        binned,
        mean=np.where(outliers, np.nan, binned.mean),
        count=np.where(outliers, 0.0, binned.count),
        outliers=tuple(int(a + b) for a, b in zip(binned.outliers, more, strict=True)),
    )
