"""Scatter from motion to motion: what a channel reads after one motion differs from replicate to replicate.

Law: Σ_ij = σ² for bins of one motion. Measured on replicates of one command, or the floor.
Source: a random effect nested in the trial, Laird, Ware, Biometrics 38 (1982).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.observations.noise_terms.term import Bins, NoiseTerm


@dataclass(frozen=True)
class MotionScatter(NoiseTerm):
    """Standard deviation from motion to motion."""

    sd: Array

    def covariance(self, bins: Bins) -> Array:
        """The same within a motion."""
        return np.asarray(self.sd[bins.channel] ** 2 * np.equal.outer(bins.motion, bins.motion))
