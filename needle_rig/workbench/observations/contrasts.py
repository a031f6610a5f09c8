"""Contrasts of replicates: what repeated commands do not share holds noise, and not the model's error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import helmert, solve_triangular

from needle_rig.numerics import Array, lower_root
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.noise import Noise, covariance
from needle_rig.workbench.observations.noise_terms.term import Bins, Places

FEWEST_BINS = 8
"""That replicates have in common: fewer show no correlation."""
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Contrasts:
    """One channel of R replicates of one command, in K bins, whitened by their mean covariance.

    A trial alone has its residuals in the place of contrasts, and shares nothing.
    """

    lower: Array
    """(K, K) Cholesky factor of the covariance."""
    independent: Array
    """(R - 1, K) Helmert contrasts, white under the noise that was given."""
    shared: Array
    """(2, K) what R replicates share, whose size may differ with their friction, and its rate of change."""

    bins: Bins
    """Those of the first."""

    @cached_property
    def basis(self) -> tuple[Array, float]:
        """Orthonormal columns (K, 2) of what is shared, and the logarithm of the determinant of their Gram
        matrix."""
        columns, triangle = np.linalg.qr(self.shared.T)
        return columns, 2.0 * float(np.log(np.abs(np.diag(triangle)) + TINY).sum())

    def unshared(self, columns: Array) -> Array:
        """(K, n) of columns over the bins, whitened, off what is shared."""
        white = solve_triangular(self.lower, columns, lower=True)
        basis, _ = self.basis
        return np.asarray(white - basis @ (basis.T @ white))

    @property
    def log_likelihood(self) -> float:
        """Restricted log-likelihood (Patterson & Thompson 1971), up to a constant: what is shared has a free
        size in each contrast."""
        basis, log_gram = self.basis
        own = self.independent - (self.independent @ basis) @ basis.T
        log_det = 2.0 * float(np.log(np.diag(self.lower)).sum()) + log_gram
        return -0.5 * float(len(own) * log_det + (own**2).sum())


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
            covariances.append(covariance(noise, Bins(binned[i], channel, own)))
        lower = lower_root(np.mean(covariances, 0))
        mean = seen.mean(0)
        rows = np.vstack(
            [helmert(len(group)) @ seen, mean, np.gradient(mean, binned[group[0]].time_s[places[0]])]
        )
        whitened = solve_triangular(lower, rows.T, lower=True).T
        first = Bins(binned[group[0]], channel, places[0])
        found.append(Contrasts(lower, whitened[:-2], whitened[-2:], first))
    return found


def each_alone(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], channel: int
) -> list[Contrasts]:
    """The residuals of every trial that has bins enough, in the place of contrasts."""
    found = []
    for trial, left in zip(binned, residuals, strict=True):
        bins = Bins.of(trial, channel)
        if bins.use.size < FEWEST_BINS:
            continue
        lower = lower_root(covariance(noise, bins))
        independent = solve_triangular(lower, left[channel, bins.use], lower=True)[None]
        found.append(Contrasts(lower, independent, np.zeros((0, bins.use.size)), bins))
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
