"""What a model's values leave on the data: by channel and place, in degrees, N·mm and noise units.

Error and noise are of one kind, so that they can be divided: root mean squares over the bins, weighed by
their samples, of data minus model and of what noise alone makes of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.learning.places import Place, all_places, scale_of, worst_places
from needle_rig.workbench.observations.noise import variance
from needle_rig.workbench.selection.documents import ChannelError, MisfitDocument


@dataclass(frozen=True)
class Misfit:
    """What one fit leaves, whether all of its values were fitted, some, or none."""

    fit: Fit = field(repr=False)
    places: tuple[Place, ...]
    """Every channel × motion × state × direction."""
    worst: tuple[Place, ...]
    channels: dict[str, ChannelError]
    error: float
    """Over noise: root mean square over the channels; NaN without a reading."""
    reduced_chi2: float

    @property
    def trial_errors(self) -> Array:
        """Root mean square of each trial's whitened residuals (T,)."""
        return np.array([np.sqrt(np.mean(r**2)) if r.size else 0.0 for r in self.fit.residuals])

    def as_json(self) -> MisfitDocument:
        """As it stands in the JSON answer."""
        return {
            "error": finite(self.error),
            "reduced_chi2": finite(self.reduced_chi2),
            "channels": self.channels,
            "worst": [p.as_json() for p in self.worst],
        }


def misfit(problem: Problem, found: Fit, names: tuple[str, ...], known: Array | None = None) -> Misfit:
    """What `found` leaves of the problem's data.

    `known` (p, m): independent deviations of the shared parameters, of one standard deviation each, that
    were not fitted; what they change counts as noise.
    """
    residuals = problem.raw(found.residuals)
    known = np.zeros((3 + len(found.parameters), 0)) if known is None else known
    spreads = problem.raw([j @ known for j in found.jacobians])
    places = all_places(problem, residuals, spreads, names)
    channels = _channels(problem, found, residuals, spreads, names, places)
    ratios = [of["in_noise_units"] for of in channels.values() if of["in_noise_units"] is not None]
    moved = (
        2 + len(found.parameters) - len(problem.fixed_places(found.parameters, found.vector.scaled_values))
    )
    return Misfit(
        found,
        tuple(places),
        worst_places(places, names),
        channels,
        float(np.sqrt(np.mean(np.square(ratios)))) if ratios else float("nan"),
        found.chi2 / max(1, problem.size - moved),
    )


def modelled(problem: Problem, fit: Fit, trial: int) -> Array:
    """What a fit says the sensors read (C, samples; N·m and rad) in one trial, at every time of its drive."""
    reading = problem.model(fit.parameters, fit.vector, trial).predict(problem.trials[trial].trial)
    return np.vstack([reading.torque_nm[None, :], reading.hall_rad.T])


def finite(value: float) -> float | None:
    """None for what JSON has no number for."""
    return float(value) if np.isfinite(value) else None


def _channels(
    problem: Problem,
    found: Fit,
    residuals: Sequence[Array],
    spreads: Sequence[Array],
    names: tuple[str, ...],
    places: Sequence[Place],
) -> dict[str, ChannelError]:
    told: dict[str, ChannelError] = {}
    for c, name in enumerate(names):
        factor, unit = scale_of(c)
        squares = expected = count = 0.0
        for binned, left, spread in zip(problem.trials, residuals, spreads, strict=True):
            of_noise = variance(problem.noise, binned, c)
            use = np.flatnonzero(np.isfinite(of_noise))
            weight = binned.count[c, use]
            squares += float((left[c, use] ** 2 * weight).sum())
            expected += float(((of_noise[use] + (spread[c, use] ** 2).sum(axis=1)) * weight).sum())
            count += float(weight.sum())
        if not count:
            continue  # not recorded, or no reading of it can be compared
        rmse, noise = (factor * np.sqrt(s / count) for s in (squares, expected))
        phases: dict[str, dict[str, dict[str, float]]] = {}
        for p in places:
            if p.channel == name:
                key = p.motion if not p.direction else f"{p.motion} {p.direction}"
                phases.setdefault(key, {})[p.state] = {
                    "error": p.error,
                    "noise": p.noise,
                    "sigmas": p.sigmas,
                }
        whitened = np.concatenate(
            [r[w.channel == c] for r, w in zip(found.residuals, problem.whiteners, strict=True)]
        )
        told[name] = {
            "rmse": float(rmse),
            "noise": float(noise),
            "in_noise_units": float(rmse / noise) if noise > 0.0 else None,
            "unit": unit,
            "whitened": finite(float(np.sqrt(np.mean(whitened**2)))) if whitened.size else None,
            "by_phase": phases,
        }
    return told
