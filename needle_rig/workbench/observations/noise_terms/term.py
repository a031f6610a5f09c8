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
        return cls(trial, channel, np.flatnonzero(np.isfinite(trial.mean[channel])))

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

    @cached_property
    def rate(self) -> Array:
        """Rate of change of the reading in each bin, N·m/s or rad/s; 0 while the base holds (k,)."""
        mean, found = self.trial.mean[self.channel, self.use], np.zeros(self.use.size)
        for m in np.unique(self.motion):
            inside = np.flatnonzero((self.motion == m) & self.trial.moving[self.use])
            if inside.size > 1:
                found[inside] = np.gradient(mean[inside], self.time_s[inside])
        return found


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
