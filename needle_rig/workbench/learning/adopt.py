"""Adding an effect to a model file, and taking the step back."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Mapping

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.model import ChannelErrors, HistoryEntry, SavedModel
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import FRICTION, TORSIONAL_RIGIDITY
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.baseline import Prepared, as_compared, null_model, prepare
from needle_rig.workbench.estimation.cross_validation import HeldOut
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.observations.noise import covariance
from needle_rig.workbench.selection.evidence import foretells
from needle_rig.workbench.selection.search import try_effect

IN_NOISE_UNITS = "noise_units"
"""Name of the errors over all channels, in units of the noise."""


class Refused(NeedleRigError):
    """The effect would not make the model better at what it has not seen."""

    exit_code = 1


def adopt(
    dataset: Dataset,
    effect: str,
    library: Mapping[str, type[Effect]],
    saved: SavedModel | None = None,
    *,
    force: bool = False,
    name: str | None = None,
    today: str | None = None,
) -> SavedModel:
    """The model with `effect` in it and every parameter refitted, with one more step in its history.

    Raises Refused when the held-out error does not fall and `force` is not given, BadInput for an effect
    that is unknown or in the model already.
    """
    if effect not in library:
        raise BadInput(f"{effect}: no such effect; there are {', '.join(sorted(library))}")
    present = saved.model if saved else null_model(dataset)
    if effect in {e.name() for e in present.effects}:
        raise BadInput(f"{effect} is in the model {present.name} already; take it back with adopt --undo")
    prepared = prepare(dataset, saved.model if saved else None, library)
    candidate = try_effect(prepared.problem, prepared.present, effect)
    found, held = candidate.fit, candidate.held
    if found is None or held is None:
        raise Refused(f"{effect} could not be fitted to {dataset.name}: the model cannot be solved with it")
    before, after = prepared.held, held
    foretold = foretells(prepared.present, before, found, after)
    if not foretold and not force:
        raise Refused(
            f"{effect} does not lower the error on commands left out"
            f" ({before.error:.3f} → {after.error:.3f} × the noise);"
            " it was not added. Add it all the same with --force."
        )
    problem, found, held = as_compared(prepared, prepared.problem, found, held)
    model = dataclasses.replace(
        problem.model(found.axes, found.point),
        name=name or (present.name if saved else dataset.name),
        element_length_m=present.element_length_m,
    )
    entry = HistoryEntry(
        added=(effect,),
        dataset=dataset.name,
        date=today or datetime.datetime.now(datetime.UTC).date().isoformat(),
        errors=ladder_errors(prepared, found, held),
        values_before=_values(prepared),
        note="" if foretold else "added by force: the error on commands left out did not fall",
    )
    return SavedModel(
        model=model,
        starts_from=saved.starts_from if saved else "null",
        uncertainties=uncertainties(found),
        history=(*(saved.history if saved else ()), entry),
    )


def undo(saved: SavedModel) -> SavedModel:
    """The model before its last step. Raises BadInput when there is none, or its values were not kept."""
    if not saved.history:
        raise BadInput(f"{saved.model.name}: its history is empty; there is no step to take back")
    last = saved.history[-1]
    if not last.values_before or last.removed:
        raise BadInput(
            f"{saved.model.name}: the last step ({last.date}) kept no values; it cannot be taken back"
        )
    model = saved.model.without(*last.added).replaced(last.values_before)
    return SavedModel(model, saved.starts_from, {}, saved.history[:-1])


def uncertainties(found: Fit) -> dict[str, float]:
    """Standard deviations by parameter name, in the units of files."""
    spread = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    known = {
        FRICTION: float(spread[0] * np.exp(found.point.log_friction) * 100),
        TORSIONAL_RIGIDITY: float(spread[1] * np.exp(found.point.log_rigidity) * 1e6),
    }
    for axis, at, error in zip(found.axes, found.point.positions, found.position_error, strict=True):
        low, high = (axis.value(float(np.clip(at + s * error, *axis.bounds))) for s in (-1, 1))
        size = abs(high - low) / 2
        if np.isfinite(size):
            known[f"{axis.effect}.{axis.name}"] = size
    return known


def ladder_errors(prepared: Prepared, found: Fit, held: HeldOut) -> dict[str, ChannelErrors]:
    """Errors of bin means before and after, by channel and over all; each channel's floor."""
    problem = prepared.problem
    before, after = _training(problem, prepared.present), _training(problem, found)
    held_before, held_after = _rms(problem, prepared.held.residuals), _rms(problem, held.residuals)
    floor = _floors(problem, found)
    errors = {}
    for c, name in enumerate(channel_names(prepared.dataset)):
        factor = nmm(1.0) if c == 0 else deg(1.0)
        errors[name] = ChannelErrors(
            training_before=factor * before[c],
            training_after=factor * after[c],
            held_out_before=_known(factor * held_before[c]),
            held_out_after=_known(factor * held_after[c]),
            floor=factor * floor[c],
        )
    errors[IN_NOISE_UNITS] = ChannelErrors(
        training_before=float(np.sqrt(prepared.present.chi2 / problem.size)),
        training_after=float(np.sqrt(found.chi2 / problem.size)),
        held_out_before=_known(prepared.held.error),
        held_out_after=_known(held.error),
        floor=1.0,
    )
    return errors


def channel_names(dataset: Dataset) -> list[str]:
    """Channels with their unit in the name."""
    return ["torque_nmm", *(f"{s}_deg" for s in dataset.sensor_names)]


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _values(prepared: Prepared) -> dict[str, float]:
    found = prepared.present
    return prepared.problem.model(found.axes, found.point).values()


def _training(problem: Problem, found: Fit) -> Array:
    readings = problem.predict(found.axes, found.point)
    return _rms(problem, tuple(b.mean - r for b, r in zip(problem.trials, readings, strict=True)))


def _rms(problem: Problem, residuals: tuple[Array, ...]) -> Array:
    count = problem.trials[0].mean.shape[0]
    if any(r.shape[:1] != (count,) for r in residuals):
        return np.full(count, np.inf)
    joined = np.hstack(residuals)
    return np.asarray(np.sqrt(np.nanmean(joined**2, axis=1)), dtype=np.float64)


def _floors(problem: Problem, found: Fit) -> Array:
    """What noise and the scatter of the trials alone leave in bin means of trials not seen, by channel."""
    count = problem.trials[0].mean.shape[0]
    total, number = np.zeros(count), np.zeros(count)
    for t, (binned, whiten) in enumerate(zip(problem.trials, problem.whiteners, strict=True)):
        for c in range(count):
            use, matrix = covariance(problem.noise, binned, c)
            if not use.size:
                continue
            own = np.linalg.solve(whiten.inverse[c], found.jacobians[t][whiten.channel == c, -1])
            total[c] += float(np.trace(matrix)) + found.scatter**2 * float(own @ own)
            number[c] += use.size
    return np.sqrt(total / np.maximum(number, 1))
