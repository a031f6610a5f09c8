"""The baseline fit: a dataset's measured noise, and the current model fitted to the data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.machine import fitting
from needle_rig.physics.needle_model import FRICTION, NeedleModel
from needle_rig.workbench.estimation.cross_validation import CrossValidation, cross_validate
from needle_rig.workbench.estimation.discretisation_error import (
    driven_at,
    refitted,
    with_discretisation_error,
)
from needle_rig.workbench.estimation.file_units import values_by_name
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.multistart import over_strength
from needle_rig.workbench.estimation.parameters import scaled_values_of
from needle_rig.workbench.estimation.posterior import start_vector
from needle_rig.workbench.estimation.problem import EXACT, Fit, Problem
from needle_rig.workbench.estimation.run_in import after_run_in
from needle_rig.workbench.estimation.unseen import unseen_names, unseen_sentences
from needle_rig.workbench.observations.binning import BinnedTrial, bin_trial
from needle_rig.workbench.observations.blocks import in_blocks
from needle_rig.workbench.observations.earlier_path import with_known_paths
from needle_rig.workbench.observations.measured_noise import measure_noise
from needle_rig.workbench.observations.noise import Noise
from needle_rig.workbench.observations.shown_terms import with_motion_scatter, with_shown_terms
from needle_rig.workbench.observations.snaps import snaps
from needle_rig.workbench.policy import POLICY

FRICTIONS_N = (2e-4, 5e-4, 1e-3, 2e-3, 4e-3)
"""Friction at which fits start, N, times the torque scale: a decade and more about the shipped needles."""
COARSE_M = 4e-3
"""Longest element of fits."""
CELLS_PER_SECTION = 6
"""Elements that the shortest tissue section has at least."""
FIRST_FITS = 2
"""Levels of friction from which the current model is fitted: the best of those above, and one more."""
REACHED = 1.5
"""χ² a value at which a converged first fit needs no second one."""
ROUNDS = 8
"""Most times that initial twists are found with the fit to those before; rigid shafts take three to six."""
SAME = 1e-3
"""Fall of −2 log density a value in a round after which twists and fit hold each other: three for three
thousand values, below what tells two explanations apart."""
OUTLIERS, OUTLIER_SHARE = 3, 0.0005
"""Outliers of a channel that are not worth a note: so many, or this share of its samples."""


@dataclass(frozen=True)
class Baseline:
    """A problem with the current model fitted to it, and that fit's cross-validation."""

    dataset: Dataset
    problem: Problem
    current: Fit
    validation: CrossValidation
    notes: tuple[str, ...]
    fine_m: float
    """Element length of the current model as it was given, m."""
    assumed_noise: tuple[str, ...] = ()
    """A sentence for each noise term that the residual alone shows, beside what a search found."""


def null_model(dataset: Dataset) -> NeedleModel:
    """Rigid tissue with uniform Coulomb friction in the dataset's geometry and needle."""
    scale = dataset.torque_scale
    rigidity_nm2 = dataset.needle.torsional_rigidity_nm2
    return NeedleModel("null", dataset.layout, rigidity_nm2, scale * FRICTIONS_N[2], torque_scale=scale)


def judged(dataset: Dataset, shaft: NeedleModel | None = None) -> Dataset:
    """What a model is held against: trials with an unknown start after a run-in, one command alone in blocks.

    Starts are found with the fitted model `shaft`; without one with the null model, its friction guessed.
    Raises BadInput, SolverError.
    """
    return in_blocks(in_whole_trials(dataset, shaft))


def in_whole_trials(dataset: Dataset, shaft: NeedleModel | None = None) -> Dataset:
    """Trials after the path that is known before them, or a run-in. Raises BadInput, SolverError."""
    model = shaft or null_model(dataset)
    coarse = dataclasses.replace(model, layout=dataset.layout, element_length_m=element_length(model))
    return after_run_in(with_known_paths(dataset), coarse, friction_known=shaft is not None)


def element_length(model: NeedleModel) -> float:
    """Element length of fits, m: 4 mm or a sixth of the shortest section; its discretisation error is a
    nuisance."""
    sections = model.layout.tissue_sections_m
    shortest = min((end - start for start, end in sections), default=COARSE_M * CELLS_PER_SECTION)
    return max(model.element_length_m, min(COARSE_M, shortest / CELLS_PER_SECTION))


def fit_baseline(
    dataset: Dataset,
    model: NeedleModel | None,
    library: Mapping[str, type[Effect]],
    prepared: Callable[[Dataset], Dataset] = judged,
    fixed: Collection[str] = (),
    say: Callable[[str], None] = lambda _: None,
) -> Baseline:
    """Measure the noise, fit the current model (default: the null model), make the discretisation error a
    nuisance.

    `prepared` is what is done to the trials before: with blocks something can be left out of one command
    alone, whole trials have one friction each. Parameters `fixed`, by name, stay as the model has them.
    `say` hears of both steps, the noise and the fit.
    Raises BadInput when the dataset has no trial or no reading, or a model file's geometry has another number
    of sensors.
    """
    if not dataset.trials:
        raise BadInput(f"{dataset.name}: no trial is left to compare with; see its notes")
    dataset = prepared(dataset)
    current = model or null_model(dataset)
    if len(current.layout.sensor_positions_m) != len(dataset.layout.sensor_positions_m):
        raise BadInput(
            f"{dataset.name} has {len(dataset.layout.sensor_positions_m)} Hall sensors and the model"
            f" {current.name} {len(current.layout.sensor_positions_m)}; give a model made for this rig"
        )
    say("measuring the noise")
    binned = tuple(bin_trial(t) for t in dataset.trials)
    noise = measure_noise(dataset.trials, binned, dataset.torque_scale)
    base = dataclasses.replace(
        current,
        layout=dataset.layout,
        torsional_rigidity_nm2=dataset.needle.torsional_rigidity_nm2,
        effects=(),
        element_length_m=element_length(current),
        torque_scale=dataset.torque_scale,
    )
    effects = {e.name(): type(e) for e in current.effects}
    problem = Problem(
        dataset.name,
        base,
        {**fitting(library, dataset.machine), **effects},
        binned,
        noise,
        max(dataset.needle.rigidity_sigma, EXACT),
    )
    if not problem.size:
        why = "\n".join(dataset.notes)
        raise BadInput(f"{dataset.name}: no reading is left to compare with; record one that changes\n{why}")
    names = tuple(effects)
    at = scaled_values_of(problem.parameters(names), current.effects)
    values = values_by_name(problem.parameters(names), current)
    problem = problem.fixing({name: values[name] for name in fixed})

    say("fitting the model")
    first = _first_fit(problem, names, at, current.friction_n if model or fixed else None)
    notes = list(_notes(problem))
    if noise.replicates:
        noise = with_motion_scatter(
            _with_shown(dataset, problem, first), binned, problem.raw(first.residuals), problem.groups
        )
        problem = problem.with_noise(noise)
        first = refitted(problem, first)
    fine_m = current.element_length_m
    problem, final = with_discretisation_error(problem, first, dataset.trials, fine_m)
    notes += unseen_sentences(unseen_names(problem, final))
    return Baseline(dataset, problem, final, cross_validate(problem, final), tuple(notes), fine_m)


def with_noise_at(baseline: Baseline, problem: Problem, found: Fit) -> Baseline:
    """The baseline under the noise that `found`, a better fit than its own, tells from what is missing.

    Itself where that shows no other noise than is known, or cannot be solved under it.
    """
    return under_noise(baseline, problem, _with_shown(baseline.dataset, problem, found))


def under_noise(baseline: Baseline, problem: Problem, noise: Noise) -> Baseline:
    """The baseline under `noise`; itself where that is `problem`'s own, or cannot be solved under it."""
    return baseline if noise is problem.noise else _fitted(baseline, baseline.problem.with_noise(noise))


def over_trials(baseline: Baseline, trials: Sequence[BinnedTrial]) -> Baseline:
    """The baseline over other trials in bins; itself where it cannot be solved over them."""
    return _fitted(baseline, baseline.problem.over(trials))


def with_starts_of(baseline: Baseline, given: Dataset, found: Fit | None = None) -> Baseline:
    """The baseline from initial twists that the fit `found` holds (default: its own); itself where it holds
    those that are known.

    `given` are the trials as recorded. Twists and fit are found in turn, while −2 log density falls by more
    than a fit's tolerance.
    """
    taken = starts_beside(baseline, given, found or baseline.current)
    return baseline if taken is None else under_starts(baseline, taken)


@dataclass(frozen=True)
class Starts:
    """Initial twists of a dataset, with the fit that they were found beside and its −2 log density."""

    dataset: Dataset
    problem: Problem
    fit: Fit
    deviance: float


def under_starts(baseline: Baseline, starts: Starts) -> Baseline:
    """The baseline from these initial twists; itself where the model cannot be solved there."""
    return _fitted(dataclasses.replace(baseline, dataset=starts.dataset), starts.problem)


def starts_are_unknown(baseline: Baseline) -> bool:
    """Whether initial twists were found beside the model, instead of recorded."""
    return any(trial.start_found for trial in baseline.dataset.trials)


def starts_beside(baseline: Baseline, given: Dataset, found: Fit, *, at_once: bool = False) -> Starts | None:
    """The initial twists that the fit `found` holds; None where those that are known do as well.

    `at_once`: those of its present values, which lie at no minimum, and one fit from there.
    """
    if not starts_are_unknown(baseline):
        return None
    problem, best = baseline.problem, None
    lowest = np.inf if at_once else deviance(problem, found)
    for _ in range(1 if at_once else ROUNDS):
        try:
            shaft = problem.model(found.parameters, found.vector)
            dataset = judged(given, shaft)
            here = problem.over([bin_trial(t) for t in dataset.trials])
            again = (fit if at_once else over_strength)(here, found.effects, found.vector)
        except (BadInput, SolverError):
            break
        if again is None:
            break
        reached = deviance(here, again)
        if reached > lowest - SAME * here.size:
            break
        problem, found, lowest = here, again, reached
        best = Starts(dataset, here, again, reached)
    return best


def deviance(problem: Problem, found: Fit) -> float:
    """−2 log density of a fit, with that of the noise."""
    return found.objective + sum(w.log_det for w in problem.whiteners)


def with_samples_at(baseline: Baseline, problem: Problem, found: Fit, gain: float) -> Baseline:
    """The baseline driven by every sample, where a `gain` on `found` may be its discretisation error.

    So it may where √gain is below three times that error's norm: in one direction or another
    `within_discretisation_error` would refuse it. Itself where it is not, or cannot be solved so.
    """
    above = math.sqrt(max(gain, 0.0)) / POLICY.evidence.discretisation_margin
    try:
        trials = driven_at(problem, found, baseline.dataset.trials, baseline.fine_m, above)
    except SolverError:
        return baseline
    return baseline if trials is None else over_trials(baseline, trials)


def _fitted(baseline: Baseline, problem: Problem) -> Baseline:
    """The baseline of another problem; itself where the model cannot be solved there."""
    trials, fine_m = baseline.dataset.trials, baseline.fine_m
    try:
        fitted = refitted(problem, baseline.current)
        problem, current = with_discretisation_error(problem, fitted, trials, fine_m)
    except SolverError:
        return baseline
    return dataclasses.replace(
        baseline, problem=problem, current=current, validation=cross_validate(problem, current)
    )


def as_baseline(
    baseline: Baseline, problem: Problem, found: Fit, validation: CrossValidation | None
) -> tuple[Problem, Fit, CrossValidation]:
    """A fit as a baseline of its own model: with the discretisation error at this fit, not at the search's
    start.

    So is noise that only a better model tells from what is missing. Where the model cannot be solved finely,
    the fit stays as it is.
    """
    try:
        noise = _with_shown(baseline.dataset, problem, found)
        if noise is not problem.noise:
            renewed = problem.with_noise(noise)
            found = refitted(renewed, found)
            problem, validation = renewed, None
        problem, found = with_discretisation_error(problem, found, baseline.dataset.trials, baseline.fine_m)
    except SolverError:
        return problem, found, validation or cross_validate(problem, found)
    return problem, found, cross_validate(problem, found)


def _with_shown(dataset: Dataset, problem: Problem, found: Fit) -> Noise:
    """The noise, with the terms that replicates show at this fit."""
    if not problem.noise.replicates or snaps(dataset):  # a snap comes at another instant in each replicate
        return problem.noise
    return with_shown_terms(problem.noise, problem.trials, problem.raw(found.residuals), problem.groups)


def _first_fit(
    problem: Problem,
    names: tuple[str, ...],
    at: Array,
    friction_n: float | None,
) -> Fit:
    """The current model's best fit from several levels of friction."""
    levels = tuple(problem.base.torque_scale * level for level in FRICTIONS_N)
    if friction_n is not None:
        levels = (friction_n,) if FRICTION in problem.fixed else (friction_n, *levels)
    parameters = problem.parameters(names)
    best: Fit | None = None
    rated = []
    for level in levels:
        vector = dataclasses.replace(
            start_vector(problem, float(np.log(level)), parameters), scaled_values=at
        )
        try:
            residuals = problem.residuals(problem.predict(parameters, vector), range(len(problem.trials)))
        except SolverError:
            continue
        rated.append((sum(float(r @ r) for r in residuals), level, vector))
    rated.sort(key=lambda r: r[0])
    for _, _, vector in rated[:FIRST_FITS]:
        found = fit(problem, names, vector)
        if found is not None and (best is None or found.objective < best.objective):
            best = found
        if best is not None and best.converged and best.chi2 < REACHED * problem.size:
            break
    if best is None:
        raise BadInput(
            f"{problem.name}: the model cannot be solved on these trials; check layout and base angles"
        )
    return best


def _notes(problem: Problem) -> list[str]:
    notes = []
    if not problem.noise.replicates:
        notes.append(
            f"No command was repeated, so that the scatter from trial to trial is assumed"
            f" ({100 * POLICY.noise.scatter:g} % of friction),"
            " not measured: take the verdict as a ranking, and repeat one command three times."
        )
    if len(problem.groups) <= 1:
        notes.append(
            "All trials are of one command, so that none can be left out to check what a model predicts:"
            " add trials with another target, speed or dwell."
        )
    names = ["torque", *(f"hall {i + 1}" for i in range(problem.trials[0].mean.shape[0] - 1))]
    for c, name in enumerate(names):
        outliers = sum(b.outliers[c] for b in problem.trials)
        total = sum(int(b.count[c].sum()) + b.outliers[c] for b in problem.trials)
        if outliers > max(OUTLIERS, OUTLIER_SHARE * total):
            notes.append(f"{name}: {outliers} of {total} samples set aside as outliers.")
    return notes
