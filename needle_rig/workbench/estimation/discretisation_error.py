"""What our own means do to a comparison: the solver's steps, and the path that drives the model."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from needle_rig.dataset import DatasetTrial, denoised_base, encoder_noise
from needle_rig.errors import SolverError
from needle_rig.numerics import Array
from needle_rig.physics.needle_model import predict_batch
from needle_rig.workbench.estimation.map_fit import Fit, fit
from needle_rig.workbench.estimation.multistart import FINE_SHAPE_STEPS, SHAPE_STEPS, over_shapes
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.observations.binning import driven_by_samples, sample_weights
from needle_rig.workbench.policy import POLICY

FINER = 8.0
DRAWS = 16
"""Paths that the encoder might as well have shown, of which the scatter of what the model makes is taken;"""
REFITS = 8
"""those to which the parameters are fitted again,"""
FAR_SIGMAS = 5.0
"""and from how far: minima of stick-slip lie close together."""


def at_own_error(
    problem: Problem, found: Fit, trials: Sequence[DatasetTrial], fine_m: float
) -> tuple[Problem, Fit]:
    """The problem with the solver's error at a fit as its first nuisance, and the fit to that problem.

    Where that error is large beside the noise, and the noise is what remains, trials drive the model by every
    sample from then on. Raises SolverError where the model cannot be solved finely.
    """
    error = solver_error(problem, found, trials, fine_m)
    near = excess(problem, found.objective) < problem.size
    if not near or np.linalg.norm(np.vstack(error)) <= POLICY.noise.straight_error_sigmas:
        return _with_suspect(problem, found, error)
    problem, found = by_every_sample(problem, found, trials)
    problem, found = _with_suspect(problem, found, solver_error(problem, found, trials, fine_m))
    found = over_shapes(problem, found, (*SHAPE_STEPS, *FINE_SHAPE_STEPS))
    return problem, _over_paths(problem, found, trials)


def solver_error(
    problem: Problem, found: Fit, trials: Sequence[DatasetTrial], fine_m: float
) -> tuple[Array, ...]:
    """What our own numerics do, whitened (n, 1) a trial: the model solved finely minus the model as used.

    Finely is on cells of `fine_m`, with an eighth of the solver's tolerance, driven by every sample.
    """
    models = [problem.model(found.axes, found.point, t) for t in range(len(trials))]
    tolerance_rad = models[0].tolerance_rad / FINER
    fine = [dataclasses.replace(m, element_length_m=fine_m, tolerance_rad=tolerance_rad) for m in models]
    seen = predict_batch(fine, [given.trial for given in trials], threads=1)
    errors = []
    for t, used in enumerate(problem.predict(found.axes, found.point)):
        values = np.vstack([seen[t].torque_nm[None, :], seen[t].hall_rad.T])
        means = (sample_weights(trials[t]) @ values.T).T
        errors.append(problem.whiteners[t](means - used)[:, None])
    return tuple(errors)


def by_every_sample(problem: Problem, found: Fit, trials: Sequence[DatasetTrial]) -> tuple[Problem, Fit]:
    """The problem driven by the base angle of every sample, and the fit to it.

    What slips and sticks by its history is bent by a coarse path as no straight nuisance is. It also slips
    elsewhere for a path that differs by the encoder's noise: the scatter that this makes is noise of the
    comparison, and is added to that of the sensors. Raises SolverError.
    """
    driven = tuple(driven_by_samples(b, t) for b, t in zip(problem.trials, trials, strict=True))
    problem = dataclasses.replace(problem, trials=driven)
    found = again(problem, found)
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
    return wider, again(wider, found)


def again(problem: Problem, old: Fit) -> Fit:
    """The fit from where another problem's ended. Raises SolverError where the model cannot be solved."""
    found = fit(problem, old.effects, old.point, nuisance=old.nuisance)
    if found is None:
        raise SolverError(f"{problem.name}: the present model could not be solved where it had been before")
    return found


def _with_suspect(problem: Problem, found: Fit, error: Sequence[Array]) -> tuple[Problem, Fit]:
    """The solver's error in the place of the first nuisance, and the fit with it."""
    nuisance = tuple(np.hstack([e, n[:, 1:]]) for e, n in zip(error, problem.nuisance, strict=True))
    suspect = dataclasses.replace(problem, nuisance=nuisance)
    return suspect, again(suspect, found)


def _encoder_scatter(problem: Problem, found: Fit, trials: Sequence[DatasetTrial]) -> tuple[Array, ...]:
    """Changes of the model's bin means (C, K, draws) a trial for other paths that the encoder might show."""
    used = problem.predict(found.axes, found.point)
    draws = []
    for draw in range(DRAWS):
        readings = _on_other_path(problem, trials, draw).predict(found.axes, found.point)
        draws.append([after - before for after, before in zip(readings, used, strict=True)])
    return tuple(np.stack(each, axis=-1) for each in zip(*draws, strict=True))


def _over_paths(problem: Problem, found: Fit, trials: Sequence[DatasetTrial]) -> Fit:
    """A fit with the spread in its covariance that fits on other paths have, each begun elsewhere.

    Derivatives know the slope between two slips, not how far the slips move a minimum: what the encoder's
    noise does to the parameters is seen by fitting again (multiple imputation: Rubin 1987, (3.1.5)).
    """
    random = np.random.default_rng(0)
    met = []
    for draw in range(REFITS):
        off = FAR_SIGMAS * found.position_error * random.standard_normal(len(found.axes))
        start = dataclasses.replace(found.point, positions=found.point.positions + off)
        other = fit(_on_other_path(problem, trials, draw), found.effects, start, nuisance=found.nuisance)
        if other is not None:
            met.append(np.r_[other.point.log_friction, other.point.log_rigidity, other.point.positions])
    if len(met) < 2:
        return found
    between = (1.0 + 1.0 / len(met)) * np.cov(np.array(met), rowvar=False)
    return dataclasses.replace(found, covariance=found.covariance + between)


def _on_other_path(problem: Problem, trials: Sequence[DatasetTrial], draw: int) -> Problem:
    """The problem driven by paths with the encoder's noise on them, denoised as measured ones are.

    A draw is the same for each trial whatever its place in the series.
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
