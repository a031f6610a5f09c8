"""Jitter of the clock: base and sensors are read at times that differ from trial to trial.

Law: Σ_ij = σ² v_i v_j, and a quarter of it on the diagonal for what varies within a trial, with v the rate of
change of the reading. Stated, not measured.
Source: the first order of r(t + δ).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.observations.noise_terms.term import Bins, NoiseTerm


@dataclass(frozen=True)
class Jitter(NoiseTerm):
    """Standard deviation of the time, s."""

    sd_s: float

    def covariance(self, bins: Bins) -> Array:
        """Of what the reading changes by in that time."""
        late = self.sd_s * bins.rate
        return np.outer(late, late) + np.diag((0.5 * late) ** 2)
