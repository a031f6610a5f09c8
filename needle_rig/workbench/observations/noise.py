"""Noise of the bin means: a sum of independent terms, and the whitener that it makes of a trial."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.linalg import solve_triangular

from needle_rig.numerics import Array, lower_root
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.noise_terms.term import Bins, NoiseTerm, Places, ShownTerm
from needle_rig.workbench.observations.noise_terms.white import White

T = TypeVar("T", bound=NoiseTerm)


@dataclass(frozen=True)
class Noise:
    """Independent terms, and how friction scatters from trial to trial."""

    terms: tuple[NoiseTerm, ...]
    """Measured before any model is fitted, or stated; one of a kind."""
    scatter: float
    """Prior relative scatter of friction from trial to trial."""
    scatter_dof: float
    replicates: int
    """Degrees of freedom among replicates; 0 when no command was repeated."""
    shown: tuple[ShownTerm, ...] = ()
    """By contrasts of replicates, or by residuals, beside a model."""

    def term(self, kind: type[T]) -> T:
        """The measured or stated term of a kind."""
        return next(t for t in self.terms if isinstance(t, kind))

    def having(self, term: NoiseTerm) -> Noise:
        """With a term in the place of that of its kind."""
        terms = tuple(term if type(t) is type(term) else t for t in self.terms)
        return dataclasses.replace(self, terms=terms)

    @property
    def white(self) -> Array:
        """Standard deviation of the white part of a sample (C,)."""
        return self.term(White).sd

    @property
    def within_trial(self) -> Array:
        """Standard deviation of a sample within a trial (C,): the white part and all that drifts or
        oscillates."""
        parts = [t.sd for t in (*self.terms, *self.shown) if isinstance(t, ShownTerm)]
        return np.asarray(np.sqrt(np.sum(np.square([self.white, *parts]), axis=0)))


def replicate_groups(commands: Sequence[object]) -> list[list[int]]:
    """Trials of equal command, in order of first appearance."""
    groups: dict[object, list[int]] = {}
    for i, command in enumerate(commands):
        groups.setdefault(command, []).append(i)
    return list(groups.values())


def covariance(noise: Noise, binned: BinnedTrial, channel: int) -> tuple[Places, Array]:
    """(bins in use (k,), covariance (k, k)) of one channel's bin means."""
    bins = Bins.of(binned, channel)
    matrix = np.zeros((bins.use.size, bins.use.size))
    for term in (*noise.terms, *noise.shown):
        matrix += term.covariance(bins)
    return bins.use, matrix


@dataclass(frozen=True)
class Whitener:
    """Turns the bin means of one trial into independent values of unit variance."""

    use: tuple[Places, ...]
    inverse: tuple[Array, ...]
    log_det: float

    def __call__(self, means: Array) -> Array:
        """(C, K, …) bin means to (n, …) whitened values, channel after channel."""
        return np.concatenate(
            [w @ means[c][u] for c, (u, w) in enumerate(zip(self.use, self.inverse, strict=True))]
        )

    def raw(self, values: Array) -> Array:
        """Bin means (C, K, …) that whiten to `values` (n, …); NaN where a channel has none."""
        bins = 1 + max((int(u.max()) for u in self.use if u.size), default=-1)
        means = np.full((len(self.use), bins, *values.shape[1:]), np.nan)
        for c, (use, inverse) in enumerate(zip(self.use, self.inverse, strict=True)):
            means[c, use] = solve_triangular(inverse, values[self.channel == c], lower=True)
        return means

    @property
    def channel(self) -> Places:
        """Channel of each whitened value (n,)."""
        return np.concatenate([np.full(u.size, c) for c, u in enumerate(self.use)])


def whitener(noise: Noise, binned: BinnedTrial) -> Whitener:
    """The whitener of one trial under `noise`."""
    use: list[Places] = []
    inverse: list[Array] = []
    log_det = 0.0
    for c in range(binned.mean.shape[0]):
        bins, matrix = covariance(noise, binned, c)
        use.append(bins)
        lower = lower_root(matrix) if bins.size else np.zeros((0, 0))
        inverted = solve_triangular(lower, np.eye(bins.size), lower=True) if bins.size else lower
        inverse.append(np.asarray(inverted, dtype=np.float64))
        log_det += 2 * float(np.log(np.diag(lower)).sum())
    return Whitener(tuple(use), tuple(inverse), log_det)
