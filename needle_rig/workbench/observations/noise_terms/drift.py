"""Noise drift: the zero of a channel wanders, and comes back, over a correlation time (Ornstein–Uhlenbeck).

Law: cov(t, t') = σ² e^(−|t − t'|/τ), averaged over each bin.
Measured on settled stretches by their autocovariance, and shown by contrasts of replicates: a hold is too
short for what wanders over seconds.
Source: Uhlenbeck, Ornstein, Phys. Rev. 36 (1930); first-order Gauss–Markov noise of IEEE Std 952.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needle_rig.numerics import Array, lower_root
from needle_rig.workbench.observations.noise_terms.term import Bins, Forms, ShownTerm

TIMES_S = np.array([0.2, 0.6, 2.0, 6.0, 20.0])
"""Correlation times that are tried."""


@dataclass(frozen=True)
class Drift(ShownTerm):
    """Standard deviation, and correlation time."""

    name: ClassVar[str] = "drift"
    unit: ClassVar[str] = "s"

    @classmethod
    def forms(cls, span_s: float, bins: int) -> Forms:  # noqa: ARG003 see ShownTerm.forms
        """Correlation times up to the length of a trial."""
        values = TIMES_S[span_s >= TIMES_S]
        return Forms(values, float(values.size))

    @classmethod
    def factor(cls, bins: Bins, forms: Array) -> Array:
        """Cholesky factors."""
        return np.stack([lower_root(correlation(bins, tau_s)) for tau_s in forms], axis=2)

    def covariance(self, bins: Bins) -> Array:
        """Without a factor, which takes time."""
        return np.asarray(self.sd[bins.channel] ** 2 * correlation(bins, self.form[bins.channel]))


def correlation(bins: Bins, tau_s: float) -> Array:
    """Correlation (k, k) of means of noise that is correlated as e^(−|t| / τ)."""
    width = bins.apart_s
    ratio = np.maximum(width / tau_s, 1e-6)
    apart = np.abs(np.subtract.outer(bins.time_s, bins.time_s))
    gap = np.maximum(apart - 0.5 * np.add.outer(width, width), 0.0)
    edge = (1 - np.exp(-ratio)) / ratio
    matrix = np.exp(-gap / tau_s) * np.outer(edge, edge)
    matrix[np.diag_indices(width.size)] = 2 * (ratio - 1 + np.exp(-ratio)) / ratio**2
    return matrix
