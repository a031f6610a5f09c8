"""Offset of a trial: the zero of a channel is another from trial to trial, and constant within one.

Law: Σ_ij = σ². Measured on rests before the first motion, about a trend over the series.
Source: the random intercept of a mixed model, Laird, Ware, Biometrics 38 (1982).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.units import rad
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.noise_terms.term import Bins, NoiseTerm
from needle_rig.workbench.policy import POLICY

FEWEST_RESTS = 4
"""Rests from which a trend and a scatter about it can be told; with fewer offsets are the floor."""
REST_DEG = 1.0
"""Motion before a rest that leaves it one."""


@dataclass(frozen=True)
class Offset(NoiseTerm):
    """Standard deviation from trial to trial."""

    sd: Array

    def covariance(self, bins: Bins) -> Array:
        """The same everywhere."""
        return np.full((bins.use.size, bins.use.size), self.sd[bins.channel] ** 2)


def measured_offset(binned: Sequence[BinnedTrial], within: Sequence[NoiseTerm], floor: Array) -> Offset:
    """Offsets beyond what the terms `within` a trial make of the mean of a rest; at least `floor` (C,)."""
    rests, variances, starts_s = [], [], []
    for b in binned:
        rest = (b.motion == 0) & ~b.moving & (np.abs(b.last_move_rad) < rad(REST_DEG))
        if rest.any() and np.all(np.isfinite(b.mean[:, rest])):
            weight = b.count[:, rest] / b.count[:, rest].sum(1, keepdims=True)
            rests.append((b.mean[:, rest] * weight).sum(1))
            inside = [Bins(b, c, np.flatnonzero(rest)) for c in range(len(weight))]
            variances.append(
                [w @ sum(t.covariance(i) for t in within) @ w for i, w in zip(inside, weight, strict=True)]
            )
            starts_s.append(b.trial.start_s)
    if len(rests) < FEWEST_RESTS:
        return Offset(floor)
    t = np.asarray(starts_s)
    t = (t - t.mean()) / (np.ptp(t) or 1.0)
    columns = np.column_stack([np.ones(t.size), t]) if np.ptp(t) > 0 else np.ones((t.size, 1))
    values, expected = np.asarray(rests), np.mean(variances, 0)
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    dof = t.size - columns.shape[1]
    excess = (left**2).sum(0) / dof - expected
    significant = excess > POLICY.evidence.likely_sigmas * expected * np.sqrt(2.0 / dof)
    return Offset(np.maximum(floor, np.where(significant, np.sqrt(np.maximum(excess, 0)), 0.0)))
