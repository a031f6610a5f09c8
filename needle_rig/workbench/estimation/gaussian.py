"""A normal distribution of the parameters that all trials share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array


@dataclass(frozen=True)
class Gaussian:
    """A normal distribution of the shared parameters: mean (p,) and covariance (p, p)."""

    mean: Array
    covariance: Array

    @property
    def deviations(self) -> Array:
        """Standard deviations (p,)."""
        return np.sqrt(np.diag(self.covariance))
