"""Contrasts of replicates: what repeated commands do not share holds noise, and not the model's error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import helmert, solve_triangular

from needle_rig.numerics import Array, lower_root
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.noise import Noise, Places, covariance

FEWEST_BINS = 8
"""That replicates have in common: fewer show no correlation."""


@dataclass(frozen=True)
class Contrasts:
    """One channel of R replicates of one command, in K bins, whitened by their mean covariance."""

    group: list[int]
    """The trials; one alone has its residuals themselves, and nothing that it shares."""
    places: Places
    """(R, K) bins that stand at the same place of the same motion."""
    lower: Array
    """(K, K) Cholesky factor of the covariance."""
    independent: Array
    """(R - 1, K) Helmert contrasts, white under the noise that was given."""
    shared: Array
    """(2, K) what the replicates share, whose size may differ with their friction, and its rate of change."""

    def whitened(self, columns: Array) -> Array:
        """(K, n) of columns over the bins, whitened."""
        return np.asarray(solve_triangular(self.lower, columns, lower=True))


def contrasts(
    noise: Noise,
    binned: Sequence[BinnedTrial],
    residuals: Sequence[Array],
    groups: list[list[int]],
    channel: int,
) -> list[Contrasts]:
    """Of every group that has bins enough in common; `residuals` are data minus model in bin means (C, K)."""
    found = []
    for group in groups:
        alike = places_alike([binned[i] for i in group])
        seen = np.array([residuals[i][channel, places] for i, places in zip(group, alike, strict=True)])
        common = np.isfinite(seen).all(0)
        if common.sum() < FEWEST_BINS:
            continue
        seen, places = seen[:, common], alike[:, common]
        covariances = []
        for i, own in zip(group, places, strict=True):
            use, matrix = covariance(noise, binned[i], channel)
            at = np.searchsorted(use, own)
            covariances.append(matrix[np.ix_(at, at)])
        lower = lower_root(np.mean(covariances, 0))
        mean = seen.mean(0)
        rows = np.vstack(
            [helmert(len(group)) @ seen, mean, np.gradient(mean, binned[group[0]].time_s[places[0]])]
        )
        whitened = solve_triangular(lower, rows.T, lower=True).T
        found.append(Contrasts(group, places, lower, whitened[:-2], whitened[-2:]))
    return found


def each_alone(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], channel: int
) -> list[Contrasts]:
    """The residuals of every trial that has bins enough, in the place of contrasts."""
    found = []
    for i, (trial, left) in enumerate(zip(binned, residuals, strict=True)):
        use, matrix = covariance(noise, trial, channel)
        if use.size < FEWEST_BINS:
            continue
        lower = lower_root(matrix)
        independent = solve_triangular(lower, left[channel, use], lower=True)[None]
        found.append(Contrasts([i], use[None], lower, independent, np.zeros((0, use.size))))
    return found


def places_alike(trials: Sequence[BinnedTrial]) -> Places:
    """Bins (R, K) of replicates that stand at the same place of the same motion."""
    found: list[Places] = []
    for m in range(min(len(b.motions) for b in trials)):
        for moving in (True, False):
            each = [np.flatnonzero((b.motion == m) & (b.moving == moving)) for b in trials]
            count = min(places.size for places in each)
            found.append(np.array([places[:count] for places in each]))
    return np.concatenate(found, axis=1)
