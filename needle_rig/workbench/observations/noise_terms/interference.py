"""Interference: an oscillation of one frequency in all channels, with a phase of its own in each trial.

Law: cov(t, t') = σ² cos 2πf(t − t'), averaged over each bin. Of the mains the beat with the sampling is seen,
which may take seconds. Shown by contrasts of replicates, or by residuals.
Source: Bretthorst, Bayesian Spectrum Analysis and Parameter Estimation (1988), ch. 2: a single harmonic.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.observations.noise_terms.term import Bins, Forms, ShownTerm

HIGHEST_HZ = 5.0
"""Faster oscillations are averaged out in the bins."""
PERIODS = 2.0
"""That a trial holds of the slowest oscillation: of fewer a frequency is not told from a drift."""
STEPS_PER_LINE = 4
"""Frequencies that are tried over the width of a line, the inverse of a trial's length."""


@dataclass(frozen=True)
class Interference(ShownTerm):
    """Standard deviation, and frequency as it is seen at the samples."""

    name: ClassVar[str] = "interference"
    unit: ClassVar[str] = "Hz"

    @classmethod
    def forms(cls, span_s: float, bins: int) -> Forms:
        """Frequencies up to 5 Hz, no more lines than half the bins tell apart."""
        step_hz = 1.0 / (STEPS_PER_LINE * span_s)
        values = np.arange(PERIODS / span_s, HIGHEST_HZ, step_hz)[: bins * STEPS_PER_LINE // 2]
        return Forms(values, values.size / STEPS_PER_LINE)

    @classmethod
    def factor(cls, bins: Bins, forms: Array) -> Array:
        """Means over the bins of the cosine and the sine."""
        phase = 2 * np.pi * np.multiply.outer(bins.time_s, forms)
        averaged = np.sinc(np.multiply.outer(bins.duration_s, forms))
        return np.stack([averaged * np.cos(phase), averaged * np.sin(phase)], axis=1)
