"""The discretisation error of the model's prediction: mesh, tolerance, and sampling of the base's path."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from needle_rig.dataset import DatasetTrial, denoised_base, encoder_noise
from needle_rig.errors import SolverError
from needle_rig.numerics import Array
from needle_rig.physics.needle_model import predict_batch
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.estimation.profile import over_profiles
from needle_rig.workbench.observations.binning import BinnedTrial, driven_by_samples, sample_weights
from needle_rig.workbench.policy import POLICY

FINER = 8.0
"""Factor by which the solver's tolerance is refined to measure the error."""
DRAWS = 16
"""Paths with other draws of the encoder's noise, from which the scatter of the prediction is taken."""
REFITS = 8
"""Imputations: paths with other draws of the encoder's noise to which the parameters are refitted."""
FAR_SIGMAS = 5.0
"""How far from the fit a refit starts, in standard deviations: minima of stick-slip lie close together."""


def with_discretisation_error(
    problem: Problem, found: Fit, trials: Sequence[DatasetTrial], fine_m: float
) -> tuple[Problem, Fit]:
    """The problem with the discretisation error at a fit as its first nuisance, and the fit to that problem.

    Where that error is large beside the noise and the fit but for it reaches the noise, the model is driven
    by every sample from then on, which removes the error of sampling; not where the fit then leaves the
    noise or is worse than before, as an effect of the base's acceleration or rate is: by every sample of
    2 kHz these are the encoder's noise. How far the worse fit lies from the other is uncertain then.
    An error of any size is large where a slip limit has a memory: it is another one at each point of the
    valley in which form and strength make up for each other, and where it fits best is not the truth.
    Raises SolverError where the model cannot be solved finely.
    """
    error = whitened_error(problem, found, trials, fine_m)
    rod = problem.model(found.parameters, found.vector).rod(problem.trials[0].trial)
    *_, memory = rod.depends_on_rate
    above = 0.0 if memory else POLICY.evidence.clear_sigmas
    driven = _driven_where_large(problem, found, trials, error, above)
    if driven is None or _worse(driven, problem, found):
        problem, found = _as_first_nuisance(problem, found, error)
        found = over_profiles(problem, found)
        return problem, found if driven is None else _apart_from(driven[1], found)
    problem, found = driven
    problem, found = _as_first_nuisance(problem, found, whitened_error(problem, found, trials, fine_m))
    between = _between_imputations(problem, found, trials)
    found = over_profiles(problem, found)
    return problem, dataclasses.replace(found, covariance=found.covariance + between)


def driven_at(
    problem: Problem, found: Fit, trials: Sequence[DatasetTrial], fine_m: float, above: float
) -> tuple[BinnedTrial, ...] | None:
    """The problem's trials driven by every sample, where the discretisation error at `found` is `above` so
    many σ over all values, and the fit reaches the noise, but for that error before; else None.

    Raises SolverError.
    """
    error = whitened_error(problem, found, trials, fine_m)
    driven = _driven_where_large(problem, found, trials, error, above)
    return None if driven is None or _worse(driven, problem, found) else driven[0].trials


def _driven_where_large(
    problem: Problem, found: Fit, trials: Sequence[DatasetTrial], error: Sequence[Array], above: float
) -> tuple[Problem, Fit] | None:
    """The problem driven by every sample and the fit to it, where `driven_at` drives it so; else None."""
    size = float(np.linalg.norm(np.vstack(error)))
    if size <= above or not _near(problem, found, size):
        return None
    driven = by_every_sample(problem, found, trials)
    return driven if _near(*driven) else None


def _worse(driven: tuple[Problem, Fit], problem: Problem, found: Fit) -> bool:
    """Whether the driven problem's fit lies above the problem's by more than chance."""
    by_chance = POLICY.evidence.clear_sigmas * math.sqrt(2.0 * problem.size)
    return driven[1].objective > found.objective + by_chance


def _apart_from(other: Fit, found: Fit) -> Fit:
    """The fit whose covariance includes how far another lies from it."""
    off = other.vector.shared - found.vector.shared
    return dataclasses.replace(found, covariance=found.covariance + np.outer(off, off))


def _near(problem: Problem, found: Fit, error: float = 0.0) -> bool:
    """Whether a fit reaches the noise, but for as much again and an error of this norm."""
    return excess(problem, found.objective) - error**2 < problem.size


def whitened_error(
    problem: Problem, found: Fit, trials: Sequence[DatasetTrial], fine_m: float
) -> tuple[Array, ...]:
    """The discretisation error, whitened (n, 1) a trial: the model solved finely minus the model as used.

    The fine solution has elements of `fine_m` and an eighth of the tolerance, and is driven by every sample.
    """
    models = [problem.model(found.parameters, found.vector, t) for t in range(len(trials))]
    tolerance_rad = models[0].tolerance_rad / FINER
    fine = [dataclasses.replace(m, element_length_m=fine_m, tolerance_rad=tolerance_rad) for m in models]
    seen = predict_batch(fine, [given.trial for given in trials], threads=1)
    errors = []
    for t, used in enumerate(problem.predict(found.parameters, found.vector)):
        values = np.vstack([seen[t].torque_nm[None, :], seen[t].hall_rad.T])
        means = np.array([w @ v for w, v in zip(sample_weights(trials[t]), values, strict=True)])
        errors.append(problem.whiteners[t](means - used)[:, None])
    return tuple(errors)


def by_every_sample(problem: Problem, found: Fit, trials: Sequence[DatasetTrial]) -> tuple[Problem, Fit]:
    """The problem driven by the base angle of every sample, and the fit to it.

    With dry friction a coarse path changes the prediction in ways that no single nuisance direction spans.
    The instants of slip also depend on the encoder's noise: the scatter of the prediction over draws of that
    noise is added to the covariance of the sensors' noise. Raises SolverError.
    """
    driven = tuple(driven_by_samples(b, t) for b, t in zip(problem.trials, trials, strict=True))
    problem = dataclasses.replace(problem, trials=driven)
    found = refitted(problem, found)
    scatter = _encoder_scatter(problem, found, trials)
    noisy = tuple(
        dataclasses.replace(b, from_encoder=s) for b, s in zip(problem.trials, scatter, strict=True)
    )
    wider = problem.over(noisy)
    nuisance = tuple(
        new(old.raw(n))
        for old, new, n in zip(problem.whiteners, wider.whiteners, problem.nuisance, strict=True)
    )
    wider = dataclasses.replace(wider, nuisance=nuisance)
    return wider, refitted(wider, found)


def refitted(problem: Problem, old: Fit) -> Fit:
    """The fit to a problem, started from the fit to another. Raises SolverError where the model cannot be
    solved."""
    found = fit(problem, old.effects, old.vector, nuisance=old.nuisance)
    if found is None:
        raise SolverError(f"{problem.name}: the current model could not be solved where it had been before")
    return found


def _as_first_nuisance(problem: Problem, found: Fit, error: Sequence[Array]) -> tuple[Problem, Fit]:
    """The discretisation error in the place of the first nuisance, and the fit with it."""
    nuisance = tuple(np.hstack([e, n[:, 1:]]) for e, n in zip(error, problem.nuisance, strict=True))
    corrected = dataclasses.replace(problem, nuisance=nuisance)
    return corrected, refitted(corrected, found)


def _encoder_scatter(problem: Problem, found: Fit, trials: Sequence[DatasetTrial]) -> tuple[Array, ...]:
    """Changes of the model's bin means (C, K, draws) a trial for other draws of the encoder's noise."""
    used = problem.predict(found.parameters, found.vector)
    draws = []
    for draw in range(DRAWS):
        readings = _on_other_path(problem, trials, draw).predict(found.parameters, found.vector)
        draws.append([after - before for after, before in zip(readings, used, strict=True)])
    return tuple(np.stack(each, axis=-1) for each in zip(*draws, strict=True))


def _between_imputations(problem: Problem, found: Fit, trials: Sequence[DatasetTrial]) -> Array:
    """Covariance (p, p) of the shared parameters between fits to other draws of the encoder's noise.

    Derivatives give the slope between two slips, not how far slips move the minimum; so the parameters are
    refitted to each draw (multiple imputation: Rubin 1987, (3.1.5)).
    """
    random = np.random.default_rng(0)
    met = []
    for draw in range(REFITS):
        off = FAR_SIGMAS * found.scaled_errors * random.standard_normal(len(found.parameters))
        start = dataclasses.replace(found.vector, scaled_values=found.vector.scaled_values + off)
        other = fit(_on_other_path(problem, trials, draw), found.effects, start, nuisance=found.nuisance)
        if other is not None:
            met.append(other.vector.shared)
    if len(met) <= 1:
        return np.zeros_like(found.covariance)
    return (1.0 + 1.0 / len(met)) * np.cov(np.array(met), rowvar=False)


def _on_other_path(problem: Problem, trials: Sequence[DatasetTrial], draw: int) -> Problem:
    """The problem driven by paths with a draw of the encoder's noise, denoised as measured paths are.

    A trial's draw does not depend on its place in the series.
    """
    drawn = []
    for binned, given in zip(problem.trials, trials, strict=True):
        path = given.trial.base_angle_rad
        if given.base_residual_rad > 0.0:
            noise = np.random.default_rng(draw).standard_normal(path.size)
            noisy = path + encoder_noise(given.base_measured_rad) * noise
            path = denoised_base(given.trial.time_s, noisy).angle_rad
        drawn.append(
            dataclasses.replace(binned, trial=dataclasses.replace(binned.trial, base_angle_rad=path))
        )
    return dataclasses.replace(problem, trials=tuple(drawn))
