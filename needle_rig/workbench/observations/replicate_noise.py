"""Noise that replicates of one command show: correlated over seconds, and scatter from motion to motion.

Replicates share what the model lacks, their contrasts do not hold it. Settled stretches show correlated noise
too, but they are short: what wanders over longer than a hold looks like an offset there.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, eigh, helmert, solve_triangular
from scipy.optimize import minimize_scalar

from needle_rig.numerics import Array
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.noise import Noise, Places, correlation, covariance, floors
from needle_rig.workbench.policy import POLICY

CORRELATION_TIMES_S = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Tried for what replicates show."""
SIZES = (1e-3, 10.0)
"""Bounds of the correlated part in units of the white one."""
MISFIT_SHARE, MISFIT_TIME_S = 0.05, 1.0
"""By which what replicates share differs among them beyond its size, as their friction does, and over what
time. Chosen: twice the scatter of friction."""
_LEAST = float(np.finfo(np.float64).tiny)
FEWEST_BINS = 8
"""That replicates have in common: fewer show no correlation."""


def with_replicates(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Noise:
    """Noise with what `groups` of replicates show of it.

    `residuals` are data minus model in bin means (C, K), a trial each, at its random effect.
    """
    replicates = [group for group in groups if len(group) > 1]
    if not replicates:
        return noise
    return _with_motion_scatter(
        _with_correlation(noise, binned, residuals, replicates), binned, residuals, replicates
    )


@dataclass(frozen=True)
class _Spectrum:
    """Contrasts of one group of replicates in the basis in which white and correlated noise are independent.

    The variances there are 1 + (correlated variance) · `correlated`.
    """

    correlated: Array
    """(K,) 1/N²m² or 1/rad²."""
    contrasts: Array
    """(R - 1, K)."""
    shared: Array
    """(2, K) what the replicates share, whose size may differ with their friction, and its rate of change."""

    def log_likelihood(self, variance: float) -> float:
        """Restricted log-likelihood (Patterson & Thompson 1971), up to a constant, with `shared` free in each
        contrast."""
        weight = 1.0 / (1.0 + variance * self.correlated)
        root = np.sqrt(weight)
        basis, triangle = np.linalg.qr((self.shared * root).T)
        left = self.contrasts * root
        left = left - (left @ basis) @ basis.T
        log_det = np.log(weight).sum() - 2.0 * np.log(np.abs(np.diag(triangle)) + _LEAST).sum()
        return 0.5 * float(log_det * len(left) - (left**2).sum())


def _with_correlation(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Noise:
    """Noise with the correlated part by restricted maximum likelihood, in channels where it is likelier."""
    correlated, correlation_s = noise.correlated.copy(), noise.correlation_s.copy()
    for c, white in enumerate(noise.white):
        now = _spectra(noise, binned, residuals, groups, c, float(noise.correlation_s[c]))
        if not now:
            continue
        present = _log_likelihood(now, float(noise.correlated[c]) ** 2)
        best = (present, float(correlated[c]), float(correlation_s[c]))
        for tau_s in CORRELATION_TIMES_S:
            spectra = _spectra(noise, binned, residuals, groups, c, tau_s)
            bounds = tuple(np.log(np.square(np.multiply(SIZES, white))))
            found = minimize_scalar(
                lambda log, at=spectra: -_log_likelihood(at, np.exp(log)), bounds=bounds, method="bounded"
            )
            best = max(best, (float(-found.fun), float(np.exp(found.x / 2)), tau_s))
        if 2.0 * (best[0] - present) > POLICY.noise.replicate_gain:
            _, correlated[c], correlation_s[c] = best
    return dataclasses.replace(noise, correlated=correlated, correlation_s=correlation_s)


def _log_likelihood(spectra: Sequence[_Spectrum], variance: float) -> float:
    return sum(spectrum.log_likelihood(variance) for spectrum in spectra)


def _spectra(
    noise: Noise,
    binned: Sequence[BinnedTrial],
    residuals: Sequence[Array],
    groups: list[list[int]],
    channel: int,
    tau_s: float,
) -> list[_Spectrum]:
    """Of every group of replicates in this channel, for noise that is correlated over `tau_s`."""
    uncorrelated = dataclasses.replace(noise, correlated=np.zeros_like(noise.correlated))
    found = []
    for group in groups:
        alike = _alike([binned[i] for i in group])
        seen = np.array([residuals[i][channel, places] for i, places in zip(group, alike, strict=True)])
        common = np.isfinite(seen).all(0)
        if common.sum() < FEWEST_BINS:
            continue
        covariances, correlations = [], []
        for i, places in zip(group, alike[:, common], strict=True):
            use, matrix = covariance(uncorrelated, binned[i], channel)
            at = np.searchsorted(use, places)
            covariances.append(matrix[np.ix_(at, at)])
            correlations.append(correlation(binned[i], places, tau_s))
        mean, time_s = seen[:, common].mean(0), binned[group[0]].time_s[alike[0, common]]
        unlike = MISFIT_SHARE**2 * np.outer(mean, mean)
        unlike *= np.exp(-np.abs(np.subtract.outer(time_s, time_s)) / MISFIT_TIME_S)
        lower = cholesky(np.mean(covariances, 0) + unlike, lower=True)
        half = solve_triangular(lower, np.mean(correlations, 0), lower=True)
        values, vectors = eigh(solve_triangular(lower, half.T, lower=True))
        mean = seen[:, common].mean(0)
        rows = np.vstack(
            [seen[:, common], mean, np.gradient(mean, binned[group[0]].time_s[alike[0, common]])]
        )
        rotated = solve_triangular(lower, rows.T, lower=True).T @ vectors
        independent, shared = rotated[:-2], rotated[-2:]
        found.append(_Spectrum(np.maximum(values, 0.0), helmert(len(group)) @ independent, shared))
    return found


def _alike(trials: Sequence[BinnedTrial]) -> Places:
    """Bins (R, K) of replicates that stand at the same place of the same motion."""
    found: list[Places] = []
    for m in range(min(len(b.motions) for b in trials)):
        for moving in (True, False):
            each = [np.flatnonzero((b.motion == m) & (b.moving == moving)) for b in trials]
            count = min(places.size for places in each)
            found.append(np.array([places[:count] for places in each]))
    return np.concatenate(found, axis=1)


def _with_motion_scatter(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Noise:
    """Noise with the scatter from motion to motion beyond friction, offset and what is correlated."""
    channel_count = residuals[0].shape[0]
    total, dof = np.zeros(channel_count), np.zeros(channel_count)
    for group in groups:
        names = min((binned[i].motions for i in group), key=len)
        for m in range(1, len(names)):
            means, variances = [], []
            for i in group:
                b = binned[i]
                settled = (b.motion == m) & ~b.moving
                weight = np.where(np.isfinite(b.mean), b.count, 0.0) * settled
                total_weight = np.maximum(weight.sum(1), 1e-9)
                means.append((np.nan_to_num(residuals[i]) * weight).sum(1) / total_weight)
                span = b.duration_s[settled].sum()
                slow = noise.correlated**2 / np.maximum(1.0, span / (2 * noise.correlation_s))
                variances.append(noise.white**2 / total_weight + slow + noise.offset**2)
            spread = np.var(np.asarray(means), axis=0, ddof=1)
            total += (len(group) - 1) * (spread - np.mean(variances, 0))
            dof += len(group) - 1
    if not dof.any():
        return noise
    floor = floors(channel_count)
    prior_dof = POLICY.noise.motion_dof
    variance = (prior_dof * floor**2 + np.maximum(total, 0.0)) / (prior_dof + dof)
    return dataclasses.replace(noise, motion=np.maximum(floor, np.sqrt(variance)))
