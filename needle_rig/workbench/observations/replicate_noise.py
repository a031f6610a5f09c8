"""Noise that replicates of one command show: correlated over seconds, hum, and scatter from motion to motion.

Replicates share what the model lacks, their contrasts do not hold it. Settled stretches show correlated noise
too, but they are short: what wanders over longer than a hold looks like an offset there. Where nothing was
repeated, the residuals themselves stand in the contrasts' place.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq, minimize_scalar

from needle_rig.numerics import Array
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.contrasts import Contrasts, contrasts, each_alone
from needle_rig.workbench.observations.hum import with_hum
from needle_rig.workbench.observations.noise import Noise, correlation
from needle_rig.workbench.policy import POLICY

CORRELATION_TIMES_S = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
"""Tried for what replicates show."""
UPPER = 1.35
"""Fall of the log-likelihood to the upper bound that is taken for the size (95 %, one-sided): few replicates
know slow noise badly, and noise that is taken too small passes for an effect."""
SIZES = (1e-3, 10.0)
"""Bounds of the correlated part in units of the white one."""
_LEAST = float(np.finfo(np.float64).tiny)


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
    log_det: float
    """Of the covariance without what is correlated."""

    def log_likelihood(self, variance: float) -> float:
        """Restricted log-likelihood (Patterson & Thompson 1971), up to a constant, with `shared` free in each
        contrast."""
        weight = 1.0 / (1.0 + variance * self.correlated)
        root = np.sqrt(weight)
        basis, triangle = np.linalg.qr((self.shared * root).T)
        left = self.contrasts * root
        left = left - (left @ basis) @ basis.T
        log_det = np.log(weight).sum() - self.log_det - 2.0 * np.log(np.abs(np.diag(triangle)) + _LEAST).sum()
        return 0.5 * float(log_det * len(left) - (left**2).sum())


@dataclass(frozen=True)
class _Channel:
    """What replicates say of one channel's correlated noise."""

    white: float
    spectra: Mapping[float, Sequence[_Spectrum]]
    """By correlation time."""
    present: float
    """Log-likelihood of the noise as it is known."""

    def log_likelihood(self, size: float, tau_s: float) -> float:
        """Of a correlated part of `size` times the white one."""
        variance = (size * self.white) ** 2
        return sum(spectrum.log_likelihood(variance) for spectrum in self.spectra[tau_s])


@dataclass(frozen=True)
class _Likeliest:
    """The likeliest correlated part of some channels together."""

    log_likelihood: float
    size: float
    """Upper bound, in units of the white part."""
    tau_s: float


def with_correlation(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Noise:
    """Noise with the correlated part and the hum that `groups` of replicates show, where they show any.

    `residuals` are data minus model in bin means (C, K), a trial each, at its random effect. By restricted
    maximum likelihood; Hall sensors are alike: what all of them show together is taken for each, unless one
    shows another size or time, and where most of them wander the torque is held to wander as much as it may.
    Where the model is wrong, replicates differ by what their friction makes of its error: then nothing is
    taken for noise, and `noise` itself comes back. Hum that is known stays.
    """
    groups = [group for group in groups if len(group) > 1]
    if not groups:
        return noise

    every = _of_replicates(noise, binned, residuals, groups)
    if _misfit(every) > POLICY.noise.replicate_misfit:
        return noise
    found = _likelier(noise, every)
    if noise.hum.any():
        return found
    humming = with_hum(found, binned, residuals, groups)
    if humming is not found:
        beside = dataclasses.replace(noise, hum=humming.hum, hum_hz=humming.hum_hz)
        every = _of_replicates(beside, binned, residuals, groups)
        found = with_hum(_likelier(beside, every), binned, residuals, groups)
    return found


def replicates_favour(
    other: Noise,
    noise: Noise,
    binned: Sequence[BinnedTrial],
    residuals: Sequence[Array],
    groups: list[list[int]],
) -> bool:
    """Whether replicates' contrasts are likelier under the correlated part of `other` than of `noise`.

    Not without replicates, nor where the model is wrong, as they differ by its error then; arguments as of
    `with_correlation`.
    """
    groups = [group for group in groups if len(group) > 1]
    every = _of_replicates(noise, binned, residuals, groups)
    if not groups or _misfit(every) > POLICY.noise.replicate_misfit:
        return False
    gain = 0.0
    for c, channel in enumerate(every):
        size, tau_s = float(other.correlated[c]) / channel.white, float(other.correlation_s[c])
        gain += channel.log_likelihood(size, tau_s) - channel.present
    return 2.0 * gain > POLICY.noise.replicate_favour


def with_correlation_left(noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array]) -> Noise:
    """Noise with the correlated part that all trials show by themselves; itself where they show none.

    `residuals` are data minus model in bin means (C, K), a trial each. By maximum likelihood.
    Nothing here tells it from what a model lacks: that is for the caller to ask.
    """
    alone = _without_correlation(noise)
    every = [
        _channel(noise, binned, each_alone(alone, binned, residuals, c), c) for c in range(noise.white.size)
    ]
    return _likelier(noise, every)


def _likelier(noise: Noise, every: Sequence[_Channel]) -> Noise:
    """Noise with the correlated part by which `every` channel is likelier; itself where that is its own."""
    correlated, correlation_s = noise.correlated.copy(), noise.correlation_s.copy()
    asked = POLICY.noise.replicate_gain / 2.0
    halls = list(range(1, noise.white.size))
    for together in ([0], halls):
        channels = {c: every[c] for c in together}
        pooled = _likeliest(list(channels.values()))
        present = sum(each.present for each in channels.values())
        # taken at the upper end of its interval, it must be likelier than what was taken so before
        taken = sum(each.log_likelihood(pooled.size, pooled.tau_s) for each in channels.values())
        is_shown = taken > present and pooled.log_likelihood - present > asked
        for c, channel in channels.items():
            own = _likeliest([channel])
            chosen, value = None, channel.present
            if is_shown:
                chosen, value = pooled, channel.log_likelihood(pooled.size, pooled.tau_s)
            if channel.present - value > asked:
                chosen, value = None, channel.present
            if own.log_likelihood - value > asked:
                at_their_time = _likeliest([channel], (pooled.tau_s,))
                if own.log_likelihood - at_their_time.log_likelihood > asked:
                    chosen = own
                elif at_their_time.log_likelihood - value > asked:
                    chosen = at_their_time
            if chosen is not None:
                correlated[c], correlation_s[c] = chosen.size * channel.white, chosen.tau_s
        if (
            together == halls
            and is_shown
            and not correlated[0]
            and 2 * (correlated[halls] > 0).sum() > len(halls)
        ):
            correlated[0] = every[0].white * _likeliest(every[:1], (pooled.tau_s,)).size
            correlation_s[0] = pooled.tau_s
    if np.array_equal(correlated, noise.correlated):
        return noise
    return dataclasses.replace(noise, correlated=correlated, correlation_s=correlation_s)


def _misfit(channels: Iterable[_Channel]) -> float:
    """Mean square of what replicates share over that of how they differ: 1 for a model that is right."""
    shared = apart = 0.0
    for channel in channels:
        for spectrum in channel.spectra[CORRELATION_TIMES_S[0]]:
            apart_each = spectrum.contrasts
            shared += (len(apart_each) + 1) * float(spectrum.shared[0] @ spectrum.shared[0])
            apart += float((apart_each**2).sum()) / len(apart_each)
    return shared / max(apart, _LEAST)


def _of_replicates(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> list[_Channel]:
    alone = _without_correlation(noise)
    return [
        _channel(noise, binned, contrasts(alone, binned, residuals, groups, c), c)
        for c in range(noise.white.size)
    ]


def _without_correlation(noise: Noise) -> Noise:
    return dataclasses.replace(noise, correlated=np.zeros_like(noise.correlated))


def _channel(noise: Noise, binned: Sequence[BinnedTrial], every: Sequence[Contrasts], c: int) -> _Channel:
    """Of a channel's contrasts, white but for what is correlated."""
    white, present_s = float(noise.white[c]), float(noise.correlation_s[c])
    spectra = {
        tau_s: [_spectrum(each, binned, tau_s) for each in every]
        for tau_s in {*CORRELATION_TIMES_S, present_s}
    }
    known = _Channel(white, spectra, 0.0).log_likelihood(float(noise.correlated[c]) / white, present_s)
    return _Channel(white, spectra, known)


def _likeliest(channels: Sequence[_Channel], times_s: Sequence[float] = CORRELATION_TIMES_S) -> _Likeliest:
    """By size and correlation time, of `times_s`; the size at the upper end of its interval."""
    low, high = np.log(SIZES)

    def at(tau_s: float) -> _Likeliest:
        def lost(log: float) -> float:
            return -sum(channel.log_likelihood(float(np.exp(log)), tau_s) for channel in channels)

        found = minimize_scalar(lost, bounds=(low, high), method="bounded")
        limit = float(found.fun) + UPPER
        bound = brentq(lambda log: lost(log) - limit, found.x, high) if lost(high) > limit else high
        return _Likeliest(-float(found.fun), float(np.exp(bound)), tau_s)

    every = [at(tau_s) for tau_s in times_s]
    best = max(every, key=lambda each: each.log_likelihood)
    likely = (each for each in every if each.log_likelihood > best.log_likelihood - UPPER)
    rate = max(each.size**2 / each.tau_s for each in (best, *likely))
    return dataclasses.replace(best, size=float(np.sqrt(rate * best.tau_s)))


def _spectrum(each: Contrasts, binned: Sequence[BinnedTrial], tau_s: float) -> _Spectrum:
    """For what is correlated over `tau_s` beside the noise by which the contrasts are white."""
    correlations = [
        correlation(binned[i], own, tau_s) for i, own in zip(each.group, each.places, strict=True)
    ]
    values, vectors = eigh(each.whitened(each.whitened(np.mean(correlations, 0)).T))
    return _Spectrum(
        np.maximum(values, 0.0),
        each.independent @ vectors,
        each.shared @ vectors,
        2.0 * float(np.log(np.diag(each.lower)).sum()),
    )


def with_motion_scatter(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Noise:
    """Noise with the scatter from motion to motion that `groups` of replicates show beyond friction, offset
    and what is correlated, no less than it had before; `residuals` as above."""
    channel_count = residuals[0].shape[0]
    total, dof = np.zeros(channel_count), np.zeros(channel_count)
    for group in groups:
        if len(group) <= 1:
            continue
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
    floor = noise.motion
    prior_dof = POLICY.noise.motion_dof
    variance = (prior_dof * floor**2 + np.maximum(total, 0.0)) / (prior_dof + dof)
    return dataclasses.replace(noise, motion=np.maximum(floor, np.sqrt(variance)))
