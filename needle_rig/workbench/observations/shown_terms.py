"""Noise terms that replicates of one command show, or residuals: drift, and interference.

Replicates share what the model lacks; their contrasts do not hold it. Settled stretches show drift too, but
they are short: what drifts over longer than a hold looks like an offset there. A term has a size of its own
in each channel and one form in all. Its likelihood is restricted (Patterson, Thompson, Biometrika 58, 1971):
what replicates share is projected out of their contrasts. Terms are added one after the other, the likeliest
first, as long as chance gives as much in fewer than 1 of 1,000 datasets.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc, comb

from needle_rig.numerics import Array
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.contrasts import TINY, Contrasts, contrasts, each_alone
from needle_rig.workbench.observations.noise import Noise, covariance
from needle_rig.workbench.observations.noise_terms.drift import Drift
from needle_rig.workbench.observations.noise_terms.interference import Interference
from needle_rig.workbench.observations.noise_terms.motion_scatter import MotionScatter
from needle_rig.workbench.observations.noise_terms.term import Bins, ShownTerm
from needle_rig.workbench.policy import POLICY

KINDS: tuple[type[ShownTerm], ...] = (Drift, Interference)
SIZES = np.geomspace(0.01, 20.0, 60)
"""Standard deviations that are tried, in units of the white part."""
UPPER = 1.35
"""Fall of the log-likelihood to the upper end that is taken for a size (95 %, one-sided): noise that is taken
too small passes for an effect."""
BETWEEN = 5
"""Forms that are tried between the neighbours of the likeliest."""
MOST_TERMS = 2
"""That are added: a drift and an interference, or two drifts."""

Channels = Sequence[Sequence[Contrasts]]
"""Of each channel, those of each group of replicates, or of each trial."""


@dataclass(frozen=True)
class _Spectrum:
    """What contrasts say of a term of F forms, in the r directions in which it is independent."""

    information: Array
    """(F, r) of the amplitude in each, 1/N²m² or 1/rad²."""
    scores: Array
    """(F, r) sums of squares of their scores, over the contrasts."""
    count: int

    @staticmethod
    def of(kind: type[ShownTerm], each: Contrasts, forms: Array) -> _Spectrum:
        factor = kind.factor(each.bins, forms)
        columns = each.unshared(factor.reshape(len(factor), -1)).reshape(factor.shape)
        by_form = np.moveaxis(columns, 2, 0)
        information, turned = np.linalg.eigh(np.swapaxes(by_form, 1, 2) @ by_form)
        scores = (each.independent @ by_form) @ turned
        return _Spectrum(np.maximum(information, 0.0), (scores**2).sum(1), len(each.independent))

    def gain(self, variance: Array) -> Array:
        """(S, F): gain of the restricted log-likelihood by the term at each variance (S,)."""
        size = variance[:, None, None]
        known = size * self.information
        return np.asarray(0.5 * (size * self.scores / (1.0 + known) - self.count * np.log1p(known)).sum(-1))


def _gains(kind: type[ShownTerm], white: Array, channels: Channels, forms: Array) -> Array:
    """(C, S, F): of each channel, by a term of each size and form."""
    none = np.zeros((SIZES.size, forms.size))
    return np.array(
        [
            sum((_Spectrum.of(kind, each, forms).gain((sd * SIZES) ** 2) for each in groups), none)
            for sd, groups in zip(white, channels, strict=True)
        ]
    )


def _gain(by_size: Array) -> Array:
    """(F,): of all channels, each at its likeliest size or without the term."""
    return np.asarray(np.maximum(by_size.max(1), 0.0).sum(0))


@dataclass(frozen=True)
class _Best:
    """The likeliest form of a kind of term."""

    kind: type[ShownTerm]
    beyond: float
    """Gain of log-likelihood beyond what chance gives."""
    form: float
    between: Array
    """Forms between its neighbours."""


def _best_form(kind: type[ShownTerm], noise: Noise, channels: Channels) -> _Best | None:
    """None where no form can be tried."""
    bins = [each.bins for groups in channels for each in groups]
    span_s = float(np.median([np.ptp(b.time_s) for b in bins])) if bins else 0.0
    if not span_s:  # one bin a trial
        return None
    forms = kind.forms(span_s, max(b.use.size for b in bins))
    if not forms.values.size:
        return None
    gain = _gain(_gains(kind, noise.white, channels, forms.values))
    best = int(np.argmax(gain))
    p = POLICY.evidence.false_alarm / forms.distinct
    beyond = float(gain[best]) - _by_chance(sum(bool(groups) for groups in channels), p)
    ends = forms.values[max(best - 1, 0)], forms.values[min(best + 1, gain.size - 1)]
    return _Best(kind, beyond, float(forms.values[best]), np.linspace(*ends, BETWEEN))


def _term(best: _Best, noise: Noise, channels: Channels) -> ShownTerm:
    """The term of the likeliest form, its sizes at the upper end of their intervals."""
    forms = np.append(best.between, best.form)
    by_size = _gains(best.kind, noise.white, channels, forms)
    at = int(np.argmax(_gain(by_size)))
    of_form = by_size[:, :, at]
    likely = of_form > np.maximum(of_form.max(1), 0.0)[:, None] - UPPER
    largest = [
        SIZES[np.flatnonzero(k)[-1]] if k.any() and groups else 0.0
        for k, groups in zip(likely, channels, strict=True)
    ]
    return best.kind(noise.white * np.array(largest), np.full(len(largest), forms[at]))


def _by_chance(channels: int, p: float) -> float:
    """Gain of log-likelihood that chance exceeds with probability `p`, of sizes that are at least 0.

    Twice the gain is a mixture of χ² (Self, Liang, J. Am. Stat. Assoc. 82, 1987, case 7).
    """
    parts = np.arange(1, channels + 1)
    weights = comb(channels, parts) / 2.0**channels
    return 0.5 * float(brentq(lambda x: float(weights @ chdtrc(parts, x)) - p, 0.0, 1e3))


def _added(noise: Noise, evidence: Callable[[Noise], Channels], most: int) -> Noise:
    """Noise with up to `most` terms more, the likeliest first."""
    for _ in range(most):
        channels = evidence(noise)
        tried = [_best_form(kind, noise, channels) for kind in KINDS]
        best = max((t for t in tried if t), key=lambda t: t.beyond, default=None)
        if best is None or best.beyond <= 0.0:
            break
        noise = dataclasses.replace(noise, shown=(*noise.shown, _term(best, noise, channels)))
    return noise


def with_shown_terms(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Noise:
    """Noise with the terms that `groups` of replicates show; itself where they show no others.

    `residuals` are data minus model in bin means (C, K), a trial each, at its random effect. Where the model
    is wrong, replicates differ by what their friction makes of its error: then nothing is learnt of noise.
    """
    groups = [group for group in groups if len(group) > 1]
    quiet = dataclasses.replace(noise, shown=())
    if not groups or _misfit(_contrasts(quiet, binned, residuals, groups)) > POLICY.noise.replicate_misfit:
        return noise
    found = _added(quiet, lambda of: _contrasts(of, binned, residuals, groups), MOST_TERMS)
    gain = _log_likelihood(found, binned, residuals, groups) - _log_likelihood(
        noise, binned, residuals, groups
    )
    return found if gain > _by_chance(1, POLICY.evidence.false_alarm) else noise


def with_residual_term(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Noise:
    """Noise with the term that residuals of all trials show; itself where they show none.

    Nothing here tells it from what a model lacks: that is for the caller to ask. Replicates, where there are
    any, must be likelier with it than without.
    """
    count = noise.white.size
    found = _added(noise, lambda of: [each_alone(of, binned, residuals, c) for c in range(count)], 1)
    groups = [group for group in groups if len(group) > 1]
    if found is noise or not groups:
        return found
    if _misfit(_contrasts(noise, binned, residuals, groups)) > POLICY.noise.replicate_misfit:
        return noise
    before, after = (_log_likelihood(n, binned, residuals, groups) for n in (noise, found))
    return found if after > before else noise


def _contrasts(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Channels:
    return [contrasts(noise, binned, residuals, groups, c) for c in range(noise.white.size)]


def _log_likelihood(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> float:
    channels = _contrasts(noise, binned, residuals, groups)
    return sum(each.log_likelihood for of_channel in channels for each in of_channel)


def _misfit(channels: Channels) -> float:
    """Mean square of what replicates share over that of how they differ: 1 for a model that is right."""
    shared = apart = 0.0
    for each in (each for of_channel in channels for each in of_channel):
        differ = each.independent
        shared += (len(differ) + 1) * float(each.shared[0] @ each.shared[0])
        apart += float((differ**2).sum()) / len(differ)
    return shared / max(apart, TINY)


def with_motion_scatter(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Noise:
    """Noise with the scatter from motion to motion that `groups` of replicates show beyond friction and all
    other terms, no less than it had before; `residuals` as above."""
    floor = noise.term(MotionScatter).sd
    others = noise.having(MotionScatter(np.zeros_like(floor)))
    total, dof = np.zeros(floor.size), np.zeros(floor.size)
    known = [_motion_means(others, b, r) for b, r in zip(binned, residuals, strict=True)]
    for group in groups:
        for m in range(1, min(len(binned[i].motions) for i in group)) if len(group) > 1 else ():
            means, variances = np.array([known[i][m] for i in group]).transpose(1, 0, 2)
            total += (len(group) - 1) * (np.var(means, axis=0, ddof=1) - variances.mean(0))
            dof += len(group) - 1
    if not dof.any():
        return noise
    prior_dof = POLICY.noise.motion_dof
    variance = (prior_dof * floor**2 + np.maximum(total, 0.0)) / (prior_dof + dof)
    return noise.having(MotionScatter(np.maximum(floor, np.sqrt(variance))))


def _motion_means(noise: Noise, binned: BinnedTrial, residuals: Array) -> list[tuple[Array, Array]]:
    """Of each motion, mean residual of its settled bins and the variance that the noise makes of it, (C,)
    each; 0 where a channel has none."""
    found = [(np.zeros(len(residuals)), np.zeros(len(residuals))) for _ in binned.motions]
    for c, left in enumerate(residuals):
        for m, (mean, variance) in enumerate(found):
            use = np.flatnonzero((binned.motion == m) & ~binned.moving & np.isfinite(binned.mean[c]))
            weight = binned.count[c, use]
            if weight.sum():
                weight = weight / weight.sum()
                matrix = covariance(noise, Bins(binned, c, use))
                mean[c], variance[c] = weight @ left[use], weight @ matrix @ weight
    return found
