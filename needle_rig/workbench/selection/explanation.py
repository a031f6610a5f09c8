"""What adopting takes over from a diagnosis: the current model with effects more, fitted, and its errors."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.errors import BadInput
from needle_rig.model import ChannelErrors
from needle_rig.numerics import Array
from needle_rig.physics.needle_model import FRICTION, NMM2_PER_NM2, TORSIONAL_RIGIDITY, NeedleModel
from needle_rig.units import deg, nmm, per_100mm
from needle_rig.workbench.estimation.baseline import Baseline, element_length, judged
from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.estimation.parameters import FreeParameter
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.estimation.simulator import Simulator
from needle_rig.workbench.observations.binning import bin_trial
from needle_rig.workbench.observations.noise import variance

IN_NOISE_UNITS = "noise_units"
"""Name of the errors over all channels, in units of the noise."""


@dataclass(frozen=True)
class Explanation:
    """Effects that the current model lacks, with the fit of the model that has them."""

    added: tuple[str, ...]
    model: NeedleModel
    uncertainties: Mapping[str, float]
    """Standard deviations by parameter name, in the units of files."""
    values_before: Mapping[str, float]
    """Parameters of the current model, fitted to the same data, by name in the units of files."""
    errors: Mapping[str, ChannelErrors]
    """Before and after, by channel and over all (`IN_NOISE_UNITS`)."""
    improves: bool
    """Whether cross-validation speaks for the effects."""
    trial_friction: tuple[float, ...] = ()
    """Each trial's friction over the common one; none where the data have no trials."""


def explanation(
    baseline: Baseline, problem: Problem, found: Fit, validation: CrossValidation, *, improves: bool
) -> Explanation:
    """A fit to traces with everything that it adds to the current model, however small.

    `problem`, `found` and `validation` are those of `as_baseline`.
    """
    current = baseline.current
    model = problem.model(found.parameters, found.vector)
    return Explanation(
        added=tuple(e for e in found.effects if e not in current.effects),
        model=dataclasses.replace(model, element_length_m=baseline.fine_m),
        uncertainties=uncertainties(found),
        values_before=baseline.problem.model(current.parameters, current.vector).values(),
        errors=errors_by_channel(baseline, found, validation),
        improves=improves,
        trial_friction=tuple(float(f) for f in np.exp(found.vector.trial_friction)),
    )


def training_errors(dataset: Dataset, found: Explanation) -> dict[str, float]:
    """Root mean square error of bin means by channel, from one simulation of each trial at its random effect.

    Raises BadInput where there are more or fewer trials than were fitted, SolverError.
    """
    dataset = judged(dataset)
    if len(dataset.trials) != len(found.trial_friction):
        raise BadInput(
            f"{dataset.name} has {len(dataset.trials)} trials, {len(found.trial_friction)} were fitted;"
            " name the data that were fitted"
        )
    model = dataclasses.replace(
        found.model, layout=dataset.layout, element_length_m=element_length(found.model)
    )
    binned = [bin_trial(t) for t in dataset.trials]
    readings = Simulator().readings([model] * len(binned), binned, found.trial_friction)
    left = np.hstack([b.mean - r for b, r in zip(binned, readings, strict=True)])
    rms = _rms_of_known(left)
    names = channel_names(dataset)
    factors = (nmm(1.0), *(deg(1.0) for _ in dataset.sensor_names))
    every = zip(names, factors, rms, strict=True)
    return {name: factor * float(e) for name, factor, e in every if np.isfinite(e)}


def uncertainties(found: Fit) -> dict[str, float]:
    """Standard deviations by parameter name, in the units of files."""
    vector = found.vector
    return spread_of_values(
        found.parameters,
        vector.shared,
        found.covariance,
    )


def spread_of_values(parameters: Sequence[FreeParameter], x: Array, covariance: Array) -> dict[str, float]:
    """Standard deviations by parameter name, in the units of files, of the parameter vector x.

    x holds the logarithms of friction (N) and torsional rigidity (N·m²), then scaled values (k,).
    """
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = {
        FRICTION: per_100mm(float(spread[0] * np.exp(x[0]))),
        TORSIONAL_RIGIDITY: float(spread[1] * np.exp(x[1]) * NMM2_PER_NM2),
    }
    for parameter, at, error in zip(parameters, x[2:], spread[2:], strict=True):
        low, high = (parameter.value(float(np.clip(at + s * error, *parameter.bounds))) for s in (-1, 1))
        size = abs(high - low) / 2
        if np.isfinite(size):
            known[f"{parameter.effect}.{parameter.name}"] = size
    return known


def errors_by_channel(
    baseline: Baseline, found: Fit, validation: CrossValidation
) -> dict[str, ChannelErrors]:
    """Errors of bin means before and after, by channel that has readings and over all; each one's floor."""
    problem = baseline.problem
    before, after = _training(problem, baseline.current), _training(problem, found)
    held_before, held_after = (
        _rms(problem, baseline.validation.residuals),
        _rms(problem, validation.residuals),
    )
    training_floor, floor = _floors(problem, found, 0.0), _floors(problem, found, found.scatter)
    errors = {}
    for c, name in enumerate(channel_names(baseline.dataset)):
        factor = nmm(1.0) if c == 0 else deg(1.0)
        if np.isnan(before[c]):
            continue
        errors[name] = ChannelErrors(
            training_before=factor * before[c],
            training_after=factor * after[c],
            held_out_before=_known(factor * held_before[c]),
            held_out_after=_known(factor * held_after[c]),
            training_floor=factor * training_floor[c],
            floor=factor * floor[c],
        )
    errors[IN_NOISE_UNITS] = ChannelErrors(
        training_before=float(np.sqrt(baseline.current.chi2 / problem.size)),
        training_after=float(np.sqrt(found.chi2 / problem.size)),
        held_out_before=_known(baseline.validation.error),
        held_out_after=_known(validation.error),
        training_floor=1.0,
        floor=1.0,
    )
    return errors


def channel_names(dataset: Dataset) -> list[str]:
    """Channels with their unit in the name."""
    return ["torque_nmm", *(f"{s}_deg" for s in dataset.sensor_names)]


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _training(problem: Problem, found: Fit) -> Array:
    readings = problem.predict(found.parameters, found.vector)
    return _rms(problem, tuple(b.mean - r for b, r in zip(problem.trials, readings, strict=True)))


def _rms(problem: Problem, residuals: tuple[Array, ...]) -> Array:
    count = problem.trials[0].mean.shape[0]
    if any(r.shape[:1] != (count,) for r in residuals):
        return np.full(count, np.inf)
    return _rms_of_known(np.hstack(residuals))


def _rms_of_known(values: Array) -> Array:
    """Root mean square of each row's numbers, NaN for a row of none: a channel that was not recorded."""
    known = np.isfinite(values)
    count = known.sum(axis=1)
    squares = np.where(known, values, 0.0) ** 2
    return np.asarray(np.sqrt(squares.sum(axis=1) / np.where(count, count, np.nan)), dtype=np.float64)


def _floors(problem: Problem, found: Fit, scatter: float) -> Array:
    """What noise and a scatter of the trials' friction alone leave in bin means, by channel."""
    count = problem.trials[0].mean.shape[0]
    total, number = np.zeros(count), np.zeros(count)
    for t, (binned, whiten) in enumerate(zip(problem.trials, problem.whiteners, strict=True)):
        for c in range(count):
            random_effect = whiten.channels[c].raw(found.jacobians[t][whiten.channel == c, -1])
            total[c] += float(np.nansum(variance(problem.noise, binned, c)))
            total[c] += scatter**2 * float(random_effect @ random_effect)
            number[c] += random_effect.size
    return np.sqrt(total / np.maximum(number, 1))
