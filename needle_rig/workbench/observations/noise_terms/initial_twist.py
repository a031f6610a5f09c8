"""Initial twist of a shaft that was wound when the recording began: what another twist would change.

Law: covariance of an ensemble of simulated initial twists that friction can hold (`estimation/run_in.py`).
Source: order preservation of dry friction: Visintin, Differential Models of Hysteresis (1994), III.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.observations.noise_terms.term import Bins, NoiseTerm


@dataclass(frozen=True)
class InitialTwist(NoiseTerm):
    """Stands in the trial."""

    def covariance(self, bins: Bins) -> Array:
        """Zero for a shaft that began relaxed."""
        moved = bins.trial.from_start
        own = np.zeros((bins.use.size, 0)) if moved is None else moved[bins.channel, bins.use]
        return np.asarray(own @ own.T)
