"""Hum: an oscillation of one frequency in all channels, whose phase is another in each trial.

Of the mains one sees the beat with the sampling, which may take seconds and then passes for what wanders, or
for an effect. It is looked for in the contrasts of replicates by restricted maximum likelihood, as a line of
their spectrum: what wanders has no frequency of its own. Where contrasts are too few, a line may be looked
for in the residuals of all trials: a missing effect leaves something there, too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtri

from needle_rig.numerics import Array
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.contrasts import Contrasts, contrasts
from needle_rig.workbench.observations.noise import Noise, Places, Whitener, oscillation
from needle_rig.workbench.policy import POLICY

HIGHEST_HZ = 5.0
"""Faster oscillations are averaged out in the bins."""
PERIODS = 2.0
"""That a trial holds of the slowest oscillation: of fewer a frequency is not told from a drift."""
PERIODS_LEFT = 3.0
"""The same where replicates do not tell: what wanders has most of its power below."""
STEPS_PER_LINE = 4
"""Frequencies that are tried over the width of a line, the inverse of a trial's length."""
SIZES = np.geomspace(0.02, 20.0, 60)
"""Standard deviations that are tried, in units of the white part."""
UPPER = 2.7
"""Fall of the log-likelihood to the upper bound that is taken (99 %, one-sided). A line that is taken too
large costs its two functions of time, one that is taken too small passes for an effect."""


@dataclass(frozen=True)
class _Line:
    """What white values say of oscillations at F frequencies."""

    information: Array
    """(F, 2) of the amplitudes of two waves that are independent, 1/N²m² or 1/rad²."""
    seen: Array
    """(R, F, 2) scores of those waves."""

    @staticmethod
    def of(values: Array, waves: Array) -> _Line:
        """Of values (R, K) in R series, and what cosine and sine (K, 2, F) are in them."""
        information, turned = np.linalg.eigh(np.einsum("kaf,kbf->fab", waves, waves))
        return _Line(np.maximum(information, 0.0), np.einsum("rk,kaf,fab->rfb", values, waves, turned))

    @staticmethod
    def of_contrasts(each: Contrasts, binned: Sequence[BinnedTrial], hz: Array) -> _Line:
        """Of a group of replicates, with what they share free in each contrast."""
        waves = oscillation(binned[each.group[0]], each.places[0], hz)
        columns = each.whitened(waves.reshape(len(waves), -1))
        basis, _ = np.linalg.qr(each.shared.T)
        return _Line.of(each.independent, (columns - basis @ (basis.T @ columns)).reshape(waves.shape))

    def gain(self, variance: Array) -> Array:
        """(S, F): gain of the restricted log-likelihood by a line of each variance (S,)."""
        times = variance[:, None, None] * self.information
        gained = variance[:, None, None] * (self.seen**2).sum(0) / (1.0 + times)
        return np.asarray(0.5 * (gained - len(self.seen) * np.log1p(times)).sum(-1))


@dataclass(frozen=True)
class _Channels:
    """The series of every channel in which a line is looked for."""

    white: Array
    each: Sequence[Sequence[Callable[[Array], _Line]]]
    """What each series of a channel says of a line at given frequencies (F,)."""

    def gains(self, hz: Array) -> Array:
        """(C, S, F): of each channel, by a line of each size and frequency."""
        none = np.zeros((SIZES.size, hz.size))
        return np.array(
            [
                sum((line(hz).gain((white * SIZES) ** 2) for line in lines), none)
                for white, lines in zip(self.white, self.each, strict=True)
            ]
        )

    def gain(self, hz: Array) -> Array:
        """(F,): of all channels, each at its likeliest size or without a line."""
        return np.asarray(np.maximum(self.gains(hz).max(1), 0.0).sum(0))


def with_hum(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], groups: list[list[int]]
) -> Noise:
    """Noise with the hum that `groups` of replicates show beside its other parts; itself where they show
    none.

    `residuals` are data minus model in bin means (C, K), a trial each, at its random effect.
    """
    groups = [group for group in groups if len(group) > 1]
    quiet = dataclasses.replace(noise, hum=np.zeros_like(noise.hum))
    every = [contrasts(quiet, binned, residuals, groups, c) for c in range(noise.white.size)]
    if not any(every):
        return noise
    lines = [[partial(_Line.of_contrasts, each, binned) for each in channel] for channel in every]
    most_bins = max(each.lower.shape[0] for channel in every for each in channel)
    return _with_line(noise, lines, [binned[i] for group in groups for i in group], most_bins, PERIODS)


def with_hum_left(
    noise: Noise, binned: Sequence[BinnedTrial], whiteners: Sequence[Whitener], residuals: Sequence[Array]
) -> Noise:
    """Noise with the line that the whitened `residuals` (n,) of all trials show; itself where they show none.

    Nothing here tells it from what a model lacks: that is for the caller to ask.
    """
    lines: list[list[Callable[[Array], _Line]]] = [[] for _ in noise.white]
    for trial, whiten, left in zip(binned, whiteners, residuals, strict=True):
        for c, of_channel in enumerate(lines):
            if whiten.use[c].size:
                values = left[whiten.channel == c][None]
                of_channel.append(partial(_line_of_trial, trial, whiten.use[c], whiten.inverse[c], values))
    most_bins = max(each.size for whiten in whiteners for each in whiten.use)
    return _with_line(noise, lines, binned, most_bins, PERIODS_LEFT)


def _line_of_trial(binned: BinnedTrial, use: Places, inverse: Array, values: Array, hz: Array) -> _Line:
    waves = oscillation(binned, use, hz)
    return _Line.of(values, (inverse @ waves.reshape(len(waves), -1)).reshape(waves.shape))


def _with_line(
    noise: Noise,
    lines: Sequence[Sequence[Callable[[Array], _Line]]],
    trials: Sequence[BinnedTrial],
    most_bins: int,
    periods: float,
) -> Noise:
    channels = _Channels(noise.white, lines)
    span_s = float(np.median([float(np.ptp(trial.time_s)) for trial in trials]))
    if not span_s:  # one bin a trial
        return noise
    step_hz = 1.0 / (STEPS_PER_LINE * span_s)
    # more lines than half the bins are not told apart
    tried_hz = np.arange(periods / span_s, HIGHEST_HZ, step_hz)[: most_bins * STEPS_PER_LINE // 2]
    if not tried_hz.size:
        return noise
    gain = channels.gain(tried_hz)
    best = int(np.argmax(gain))
    chance = POLICY.noise.hum_significance * STEPS_PER_LINE / tried_hz.size
    if 2.0 * gain[best] < float(chdtri(len(lines), chance)):
        return noise
    around = tried_hz[best] + step_hz * np.array([-1.0, 1.0])
    found = minimize_scalar(
        lambda hz: -float(channels.gain(np.array([hz]))[0]), bounds=around, method="bounded"
    )
    by_size = channels.gains(np.array([found.x]))[:, :, 0]
    likely = by_size > np.maximum(by_size.max(1), 0.0)[:, None] - UPPER
    largest = np.array(
        [SIZES[np.flatnonzero(k)[-1]] if k.any() and of else 0.0 for k, of in zip(likely, lines, strict=True)]
    )
    return dataclasses.replace(noise, hum=noise.white * largest, hum_hz=float(found.x))
