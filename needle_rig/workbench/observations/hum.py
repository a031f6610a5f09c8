"""Hum: an oscillation of one frequency in all channels, whose phase is another in each trial.

Of the mains one sees the beat with the sampling, which may take seconds and then passes for what wanders, or
for an effect. It is looked for in the contrasts of replicates by restricted maximum likelihood, as a line of
their spectrum: what wanders has no frequency of its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from needle_rig.numerics import Array
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.contrasts import Contrasts, contrasts
from needle_rig.workbench.observations.noise import Noise, oscillation
from needle_rig.workbench.policy import POLICY

HIGHEST_HZ = 5.0
"""Faster oscillations are averaged out in the bins."""
PERIODS = 2.0
"""That a trial holds of the slowest oscillation: of fewer a frequency is not told from a drift."""
STEPS_PER_LINE = 4
"""Frequencies that are tried over the width of a line, the inverse of a trial's length."""
SIZES = np.geomspace(0.02, 20.0, 60)
"""Standard deviations that are tried, in units of the white part."""
UPPER = 2.7
"""Fall of the log-likelihood to the upper bound that is taken (99 %, one-sided). A line that is taken too
large costs its two functions of time, one that is taken too small passes for an effect."""


@dataclass(frozen=True)
class _Line:
    """What contrasts of a group of replicates and a channel say of oscillations at F frequencies."""

    information: Array
    """(F, 2) of the amplitudes of two waves that are independent, 1/N²m² or 1/rad²."""
    seen: Array
    """(R - 1, F, 2) scores of those waves."""

    @staticmethod
    def of(each: Contrasts, binned: BinnedTrial, hz: Array) -> _Line:
        """With what the replicates share free in each contrast."""
        waves = oscillation(binned, each.places[0], hz)
        columns = each.whitened(waves.reshape(len(waves), -1))
        basis, _ = np.linalg.qr(each.shared.T)
        columns = (columns - basis @ (basis.T @ columns)).reshape(waves.shape)
        information, turned = np.linalg.eigh(np.einsum("kaf,kbf->fab", columns, columns))
        scores = np.einsum("rk,kaf,fab->rfb", each.independent, columns, turned)
        return _Line(np.maximum(information, 0.0), scores)

    def gain(self, variance: Array) -> Array:
        """(S, F): gain of the restricted log-likelihood by a line of each variance (S,)."""
        times = variance[:, None, None] * self.information
        gained = variance[:, None, None] * (self.seen**2).sum(0) / (1.0 + times)
        return np.asarray(0.5 * (gained - len(self.seen) * np.log1p(times)).sum(-1))


@dataclass(frozen=True)
class _Channels:
    """The contrasts of every channel."""

    noise: Noise
    binned: Sequence[BinnedTrial]
    each: list[list[Contrasts]]

    def gains(self, hz: Array) -> Array:
        """(C, S, F): of each channel, by a line of each size and frequency."""
        return np.array(
            [
                sum(
                    (
                        _Line.of(group, self.binned[group.group[0]], hz).gain((white * SIZES) ** 2)
                        for group in groups
                    ),
                    np.zeros((SIZES.size, hz.size)),
                )
                for white, groups in zip(self.noise.white, self.each, strict=True)
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
    channels = _Channels(noise, binned, every)
    span_s = float(np.median([float(np.ptp(binned[i].time_s)) for group in groups for i in group]))
    step_hz = 1.0 / (STEPS_PER_LINE * span_s)
    most_bins = max(group.lower.shape[0] for channel in every for group in channel)
    # more lines than half the bins are not told apart
    tried_hz = np.arange(PERIODS / span_s, HIGHEST_HZ, step_hz)[: most_bins * STEPS_PER_LINE // 2]
    if not tried_hz.size:
        return noise
    gain = channels.gain(tried_hz)
    best = int(np.argmax(gain))
    chance = POLICY.noise.hum_significance * STEPS_PER_LINE / tried_hz.size
    if 2.0 * gain[best] < chi2.isf(chance, len(every)):
        return noise
    around = tried_hz[best] + step_hz * np.array([-1.0, 1.0])
    found = minimize_scalar(
        lambda hz: -float(channels.gain(np.array([hz]))[0]), bounds=around, method="bounded"
    )
    by_size = channels.gains(np.array([found.x]))[:, :, 0]
    likely = by_size > np.maximum(by_size.max(1), 0.0)[:, None] - UPPER
    largest = np.array([SIZES[np.flatnonzero(each)[-1]] if each.any() else 0.0 for each in likely])
    return dataclasses.replace(noise, hum=noise.white * largest, hum_hz=float(found.x))
