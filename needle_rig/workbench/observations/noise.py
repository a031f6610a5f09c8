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


def covariance(noise: Noise, bins: Bins) -> Array:
    """Covariance (k, k) of these bin means of one channel."""
    matrix = np.zeros((bins.use.size, bins.use.size))
    for term in (*noise.terms, *noise.shown):
        matrix += term.covariance(bins)
    return matrix


def variance(noise: Noise, binned: BinnedTrial, channel: int) -> Array:
    """Variance (K,) of each bin mean of one channel; NaN where it has none."""
    found = np.full(binned.mean.shape[1], np.nan)
    for part in _parts(Bins.of(binned, channel).use):
        found[part] = np.diag(covariance(noise, Bins(binned, channel, part)))
    return found


BLOCK = 512
"""Bins that are whitened at once, given as many before them: exact up to twice as many."""


@dataclass(frozen=True)
class Block:
    """Bins in a row, and those before them on which they are conditioned."""

    first: int
    """Of the bins before."""
    inverse: Array
    """(b, m + b), from the means of the m bins before and the b own ones to b whitened values."""

    @property
    def before(self) -> slice:
        """Bins before."""
        return slice(self.first, self.first + self.inverse.shape[1] - self.inverse.shape[0])

    @property
    def rows(self) -> slice:
        """Own bins."""
        return slice(self.before.stop, self.first + self.inverse.shape[1])

    @property
    def of_before(self) -> Array:
        """(b, m)."""
        return self.inverse[:, : -len(self.inverse)]

    @property
    def own(self) -> Array:
        """(b, b), lower triangular."""
        return self.inverse[:, -len(self.inverse) :]


@dataclass(frozen=True)
class ChannelWhitener:
    """Inverse root of the covariance of one channel's n bins in use, in blocks.

    A long trial has its covariance by Vecchia's approximation: a block given all bins before it is taken as
    given the block before it. Source: Katzfuss, Guinness, Statistical Science 36 (2021), 124.
    """

    use: Places
    blocks: tuple[Block, ...]

    def __call__(self, means: Array) -> Array:
        """(n, …) means of the bins in use to whitened values."""
        parts = [block.inverse @ means[block.first : block.rows.stop] for block in self.blocks]
        return np.concatenate(parts) if parts else means

    def raw(self, values: Array) -> Array:
        """(n, …) means that whiten to `values`."""
        means = np.zeros_like(values)
        for block in self.blocks:
            given = values[block.rows] - block.of_before @ means[block.before]
            means[block.rows] = solve_triangular(block.own, given, lower=True)
        return means

    def of_averages(self, weights: Array) -> Array:
        """(r, n), from whitened values to r averages of the means, by their weights (r, n).

        The product with its transpose is the covariance of the averages.
        """
        left, found = np.array(weights.T), np.zeros(weights.T.shape)
        for block in reversed(self.blocks):
            found[block.rows] = solve_triangular(block.own, left[block.rows], lower=True, trans=1)
            left[block.before] -= block.of_before.T @ found[block.rows]
        return np.asarray(found.T)


@dataclass(frozen=True)
class Whitener:
    """Turns the bin means of one trial into independent values of unit variance."""

    channels: tuple[ChannelWhitener, ...]
    log_det: float
    """Of the covariance."""

    def __call__(self, means: Array) -> Array:
        """(C, K, …) bin means to (n, …) whitened values, channel after channel."""
        return np.concatenate([w(means[c][w.use]) for c, w in enumerate(self.channels)])

    def raw(self, values: Array) -> Array:
        """Bin means (C, K, …) that whiten to `values` (n, …); NaN where a channel has none."""
        bins = 1 + max((int(w.use.max()) for w in self.channels if w.use.size), default=-1)
        means = np.full((len(self.channels), bins, *values.shape[1:]), np.nan)
        for c, w in enumerate(self.channels):
            means[c, w.use] = w.raw(values[self.channel == c])
        return means

    @property
    def use(self) -> tuple[Places, ...]:
        """Bins of each channel that are in use."""
        return tuple(w.use for w in self.channels)

    @property
    def channel(self) -> Places:
        """Channel of each whitened value (n,)."""
        return np.concatenate([np.full(w.use.size, c) for c, w in enumerate(self.channels)])


def whitener(noise: Noise, binned: BinnedTrial) -> Whitener:
    """The whitener of one trial under `noise`."""
    channels: list[ChannelWhitener] = []
    log_det = 0.0
    for c in range(binned.mean.shape[0]):
        use, blocks, before = Bins.of(binned, c).use, [], 0
        start = 0
        for part in _parts(use):
            window = use[start - before : start + part.size]
            lower = lower_root(covariance(noise, Bins(binned, c, window)))
            inverse = solve_triangular(lower, np.eye(window.size), lower=True)
            blocks.append(Block(start - before, np.array(inverse[before:], dtype=np.float64)))
            log_det += 2 * float(np.log(np.diag(lower)[before:]).sum())
            start, before = start + part.size, part.size
        channels.append(ChannelWhitener(use, tuple(blocks)))
    return Whitener(tuple(channels), log_det)


def _parts(use: Places) -> list[Places]:
    """Bins in the blocks in which they are whitened."""
    if use.size <= 2 * BLOCK:
        return [use] if use.size else []
    return np.array_split(use, -(-use.size // BLOCK))
