"""From a dataset and a present model to a problem with measured noise and the present model's best fit."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.estimation.cross_validation import HeldOut, held_out
from needle_rig.workbench.estimation.discretisation_error import again, at_own_error
from needle_rig.workbench.estimation.map_fit import Fit, fit
from needle_rig.workbench.estimation.parameters import positions_of
from needle_rig.workbench.estimation.posterior import start_point
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.observations.binning import bin_trial
from needle_rig.workbench.observations.noise import measure_noise, with_replicate_scatter
from needle_rig.workbench.policy import POLICY

FRICTIONS_N = (2e-4, 5e-4, 1e-3, 2e-3, 4e-3)
COARSE_M = 4e-3
CELLS_PER_SECTION = 6


@dataclass(frozen=True)
class Prepared:
    """A problem with the present model fitted to it."""

    dataset: Dataset
    problem: Problem
    present: Fit
    held: HeldOut
    notes: tuple[str, ...]
    fine_m: float
    """Element length of the present model as it was given."""


def null_model(dataset: Dataset) -> NeedleModel:
    """Rigid tissue with uniform Coulomb friction in the dataset's geometry and needle."""
    return NeedleModel("null", dataset.layout, dataset.needle.torsional_rigidity_nm2, FRICTIONS_N[2])


def element_length(model: NeedleModel) -> float:
    """Cells for fits: 4 mm or a sixth of the shortest section; what that costs in accuracy is a nuisance."""
    sections = model.layout.tissue_sections_m
    shortest = min((end - start for start, end in sections), default=COARSE_M * CELLS_PER_SECTION)
    return max(model.element_length_m, min(COARSE_M, shortest / CELLS_PER_SECTION))


def prepare(dataset: Dataset, model: NeedleModel | None, library: Mapping[str, type[Effect]]) -> Prepared:
    """Measure the noise, fit the present model (default: the null model), make the solver a suspect.

    Raises BadInput when the dataset has no trial, or a model file's geometry has another number of sensors.
    """
    if not dataset.trials:
        raise BadInput(f"{dataset.name}: no trial is left to compare with; see its notes")
    present = model or null_model(dataset)
    if len(present.layout.sensor_positions_m) != len(dataset.layout.sensor_positions_m):
        raise BadInput(
            f"{dataset.name} has {len(dataset.layout.sensor_positions_m)} Hall sensors and the model"
            f" {present.name} {len(present.layout.sensor_positions_m)}; give a model made for this rig"
        )
    binned = tuple(bin_trial(t) for t in dataset.trials)
    noise = measure_noise(dataset.trials, binned)
    base = dataclasses.replace(
        present,
        layout=dataset.layout,
        torsional_rigidity_nm2=dataset.needle.torsional_rigidity_nm2,
        effects=(),
        element_length_m=element_length(present),
    )
    effects = {e.name(): type(e) for e in present.effects}
    problem = Problem(
        dataset.name, base, {**library, **effects}, binned, noise, max(dataset.needle.rigidity_sigma, 1e-4)
    )
    names = tuple(effects)
    at = positions_of(problem.axes(names), present.effects)
    first = _first_fit(problem, names, at, present.friction_n if model else None)
    notes = list(_notes(problem))
    if noise.replicates:
        left = _left(problem, first)
        noise = with_replicate_scatter(noise, binned, left, problem.groups)
        problem = problem.with_noise(noise)
        first = again(problem, first)
    fine_m = present.element_length_m
    problem, final = at_own_error(problem, first, dataset.trials, fine_m)
    return Prepared(dataset, problem, final, held_out(problem, final), tuple(notes), fine_m)


def as_compared(
    prepared: Prepared, problem: Problem, found: Fit, held: HeldOut | None
) -> tuple[Problem, Fit, HeldOut]:
    """A fit as a comparison with its model sees it: our solver's error is the one there, not where it began.

    What cannot be solved finely stays as it is.
    """
    try:
        problem, found = at_own_error(problem, found, prepared.dataset.trials, prepared.fine_m)
    except SolverError:
        return problem, found, held or held_out(problem, found)
    return problem, found, held_out(problem, found)


def _first_fit(problem: Problem, names: tuple[str, ...], at: Array, friction_n: float | None) -> Fit:
    """The present model's best fit from several levels of friction."""
    levels = FRICTIONS_N if friction_n is None else (friction_n, *FRICTIONS_N)
    axes = problem.axes(names)
    best: Fit | None = None
    rated = []
    for level in levels:
        point = dataclasses.replace(start_point(problem, float(np.log(level)), axes), positions=at)
        try:
            rows = problem.residuals(problem.predict(axes, point), range(len(problem.trials)))
        except SolverError:
            continue
        rated.append((sum(float(r @ r) for r in rows), level, point))
    rated.sort(key=lambda r: r[0])
    for _, _, point in rated[:2]:
        found = fit(problem, names, point)
        if found is not None and (best is None or found.objective < best.objective):
            best = found
        if best is not None and best.converged and best.chi2 < 1.5 * problem.size:
            break
    if best is None:
        raise BadInput(
            f"{problem.name}: the model cannot be solved on these trials; check layout and base angles"
        )
    return best


def _left(problem: Problem, found: Fit) -> list[Array]:
    """Data minus model in bin means (C, K), at each trial's own friction."""
    readings = problem.predict(found.axes, found.point)
    return [b.mean - r for b, r in zip(problem.trials, readings, strict=True)]


def _notes(problem: Problem) -> list[str]:
    notes = []
    if not problem.noise.replicates:
        notes.append(
            f"No command was repeated, so that the scatter from trial to trial is assumed"
            f" ({100 * POLICY.noise.scatter:g} % of friction),"
            " not measured: take the verdict as a ranking, and repeat one command three times."
        )
    if len(problem.groups) < 2:
        notes.append(
            "All trials are of one command, so that none can be left out to check what a model foretells:"
            " add trials with another target, speed or dwell."
        )
    names = ["torque", *(f"hall {i + 1}" for i in range(problem.trials[0].mean.shape[0] - 1))]
    for c, name in enumerate(names):
        outliers = sum(b.outliers[c] for b in problem.trials)
        total = sum(int(b.count[c].sum()) + b.outliers[c] for b in problem.trials)
        if outliers > max(3, 0.0005 * total):
            notes.append(f"{name}: {outliers} of {total} samples set aside as outliers.")
    return notes
