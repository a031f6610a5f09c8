"""The contract of a noise term: its covariance of the bin means of one channel of one trial.

A term that is not measured on settled stretches is *shown* by contrasts of replicates, or by residuals. It
then states the forms to try (a correlation time, a frequency) and its covariance as a product of factors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from needle_rig.numerics import Array
from needle_rig.workbench.observations.binning import BinnedTrial

ROUNDED = 1e-6
"""Overlap, over the bins' length, that rounding of times makes."""
Places = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Bins:
    """The k bins of one channel of a trial that hold readings."""

    trial: BinnedTrial
    channel: int
    use: Places

    @classmethod
    def of(cls, trial: BinnedTrial, channel: int) -> Self:
        """All that hold a reading."""
        every = cls(trial, channel, np.arange(trial.mean.shape[1]))._every
        return cls(trial, channel, every)

    @property
    def time_s(self) -> Array:
        """Mean time of each bin (k,)."""
        return self.trial.time_s[self.use]

    @property
    def duration_s(self) -> Array:
        """Time over which each bin averages (k,)."""
        return np.asarray(self.trial.duration_s[self.use])

    @property
    def samples(self) -> Array:
        """Samples in each bin (k,)."""
        return np.asarray(self.trial.count[self.channel, self.use])

    @property
    def motion(self) -> Places:
        """Motion that each bin belongs to (k,)."""
        return self.trial.motion[self.use]

    @property
    def apart_s(self) -> Array:
        """Durations (k,) shortened where neighbours would overlap, as by uneven samples: means of noise over
        stretches that overlap have another covariance."""
        trial, every = self.trial, self._every
        duration_s = trial.duration_s[every]
        reach = 0.5 * (duration_s[1:] + duration_s[:-1])
        share = np.minimum(np.diff(trial.time_s[every]) / reach, 1.0)
        share[share > 1.0 - ROUNDED] = 1.0
        found = np.zeros(trial.mean.shape[1])
        found[every] = duration_s * np.minimum(np.r_[1.0, share], np.r_[share, 1.0])
        return found[self.use]

    @cached_property
    def rate(self) -> Array:
        """Rate of change of the reading in each bin, N·m/s or rad/s; 0 while the base holds (k,)."""
        trial, found = self.trial, np.zeros(self.trial.mean.shape[1])
        moving = self._every[trial.moving[self._every]]
        if moving.size > 1:
            step_s = np.diff(trial.time_s[moving])
            slope = np.diff(trial.mean[self.channel, moving]) / step_s
            # an end of a motion has the slope on its one side
            weight = np.where(np.diff(trial.motion[moving]) == 0, 1.0 / step_s, 0.0)
            sides = np.r_[0.0, weight] + np.r_[weight, 0.0]
            sums = np.r_[0.0, weight * slope] + np.r_[weight * slope, 0.0]
            found[moving] = sums / np.where(sides > 0, sides, 1.0)
        return found[self.use]

    @property
    def _every(self) -> Places:
        """All that hold a reading: what depends on neighbours is the same in each choice of bins."""
        return np.flatnonzero(np.isfinite(self.trial.mean[self.channel]))


class NoiseTerm(ABC):
    """A part of the noise that is independent of the others. Sizes are an entry a channel: N·m, then rad."""

    @abstractmethod
    def covariance(self, bins: Bins) -> Array:
        """Covariance (k, k) of the bin means, N²m² or rad²."""


@dataclass(frozen=True)
class Forms:
    """Forms to try (F,), in rising order, and how many of them a series tells apart."""

    values: Array
    distinct: float


@dataclass(frozen=True)
class ShownTerm(NoiseTerm):
    """A term of a size in each channel and one form, which contrasts or residuals show."""

    sd: Array
    form: Array
    """An entry a channel."""

    name: ClassVar[str]
    unit: ClassVar[str]
    """Of the form."""

    @classmethod
    @abstractmethod
    def forms(cls, span_s: float, bins: int) -> Forms:
        """Forms that trials of this length show, in so many bins."""

    @classmethod
    @abstractmethod
    def factor(cls, bins: Bins, forms: Array) -> Array:
        """(k, r, F): with these forms (F,), its covariance at unit size is factor · factorᵀ."""

    def covariance(self, bins: Bins) -> Array:
        """As given by its factor."""
        factor = self.factor(bins, self.form[[bins.channel]])[:, :, 0]
        return np.asarray(self.sd[bins.channel] ** 2 * factor @ factor.T)
