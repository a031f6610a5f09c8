"""White noise of every sample: independent from one to the next.

Law: Σ_ij = σ² δ_ij / n_i, with n_i samples in a bin. Measured on settled stretches by their autocovariance.
Source: Allan, Proc. IEEE 54 (1966), white phase noise; quantisation counts as such from half a step on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.observations.noise_terms.term import Bins, NoiseTerm


@dataclass(frozen=True)
class White(NoiseTerm):
    """Standard deviation of one sample."""

    sd: Array

    def covariance(self, bins: Bins) -> Array:
        """Diagonal."""
        return np.diag(self.sd[bins.channel] ** 2 / bins.samples)
