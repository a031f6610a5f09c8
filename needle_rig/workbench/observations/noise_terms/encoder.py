"""Noise of the base encoder, which drives the model: what another reading of the same path would change.

Law: mean of the outer products of what redrawn paths change (`estimation/discretisation_error.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.observations.noise_terms.term import Bins, NoiseTerm


@dataclass(frozen=True)
class Encoder(NoiseTerm):
    """Stands in the trial."""

    def covariance(self, bins: Bins) -> Array:
        """Zero where the encoder's noise moves no reading."""
        moved = bins.trial.from_encoder
        if moved is None:
            return np.zeros((bins.use.size, bins.use.size))
        own = moved[bins.channel, bins.use]
        return np.asarray(own @ own.T / own.shape[1])
