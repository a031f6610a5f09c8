"""Constants of a rig from its own recordings: each with its uncertainty, or what would have to be recorded.

The fit is that of `compare`, over whole trials. What its data say apart from every prior (`Information`) is
put together with what is known before: the stated torsional rigidity, or a model file, whose uncertainties
are then the prior (sequential Bayesian estimation).
"""

from __future__ import annotations

import dataclasses
import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri, ndtr, ndtri, stdtrit

from needle_rig.dataset import Dataset
from needle_rig.dataset.records import UNKNOWN_SIGMA
from needle_rig.dataset.units_check import LEAST_TWIST_DEG
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.model import HistoryEntry, SavedModel
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.machine import NEEDLE
from needle_rig.physics.needle_model import (
    FRICTION,
    TORSIONAL_RIGIDITY,
    NeedleModel,
)
from needle_rig.records import JsonObject
from needle_rig.workbench.estimation.baseline import (
    FRICTIONS_N,
    Baseline,
    fit_baseline,
    in_whole_trials,
    null_model,
)
from needle_rig.workbench.estimation.file_units import (
    deviations_in_file_units,
    in_file_units,
    known_of,
    shared_units,
    within_bounds,
)
from needle_rig.workbench.estimation.gaussian import Gaussian
from needle_rig.workbench.estimation.information import Information
from needle_rig.workbench.estimation.parameters import FreeParameter, shared_names
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.learning.joint import JointFriction, joint_friction, seen, twist_is_seen
from needle_rig.workbench.learning.steps import numbered
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.answer import Say
from needle_rig.workbench.selection.values import CONTRADICTS, spelt_p

SCATTER = "friction_scatter"
RATIO = "friction_over_rigidity"
DAMPING = "viscous_slip"
CONFIDENCE = 0.95
NARROWED = 0.5
"""Standard deviation after over before a recording from which on it gives nothing: it holds less than three
times the information that was there without it."""


class Contradiction(NeedleRigError):
    """A recording and a model file do not agree."""

    exit_code = 1


@dataclass(frozen=True)
class Estimate:
    """One constant, in the unit of files, or what would have to be recorded for it."""

    name: str
    unit: str
    value: float | None
    """None where the recording does not give it."""
    uncertainty: float | None
    """One standard deviation."""
    interval: tuple[float, float] | None
    """95 %."""
    experiment: str = ""
    """What would give the constant that the recording does not."""
    at_most: float | None = None
    """The size that the recording leaves possible, of one that it does not tell from 0; 95 %."""

    def as_json(self) -> JsonObject:
        """As it stands in the JSON answer; JSON has no infinity, which is written as text."""
        numbers = (self.value, self.uncertainty, *(self.interval or (None, None)))
        value, uncertainty, low, high = (n if n is None or np.isfinite(n) else str(n) for n in numbers)
        return {
            "name": self.name,
            "unit": self.unit,
            "value": value,
            "uncertainty": uncertainty,
            "interval": None if self.interval is None else [low, high],
            "experiment": self.experiment,
            "at_most": self.at_most,
        }

    def sentence(self) -> str:
        """In words."""
        bound = "" if self.at_most is None else f", at most {self.at_most:.3g} {self.unit} (95 %)"
        if self.value is None or self.interval is None:
            return f"{self.name}: not identifiable from this recording{bound}; {self.experiment}"
        low, high = self.interval
        return (
            f"{self.name} = {self.value:.5g} ± {self.uncertainty:.2g} {self.unit}"
            f" (95 %: {low:.5g} to {high:.5g})" + (f": not told from 0{bound}" if bound else "")
        )


@dataclass(frozen=True)
class Identification:
    """What a recording says of a model's parameters, with what was known before."""

    baseline: Baseline = field(repr=False)
    information: Information = field(repr=False)
    posterior: Gaussian = field(repr=False)
    estimates: tuple[Estimate, ...]
    """Friction, torsional rigidity, damping, further parameters of the model, the ratio of the first two
    where angles alone give it, scatter of friction."""
    misfit: float
    """Root mean square of what the model leaves, in units of the noise: 1 is the floor."""
    joint: JointFriction | None = None
    """Friction of a plain joint, where no twist is seen; for another machine than a needle the answer."""

    @property
    def parameters(self) -> tuple[FreeParameter, ...]:
        """The effects' parameters, in the order of the vectors from the third entry on."""
        return self.baseline.current.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters in the order of the vectors, as files call them."""
        return shared_names(self.parameters)

    def sentences(self) -> list[str]:
        """Every estimate, what the model leaves, and notes."""
        said = [e.sentence() for e in self.estimates]
        current, problem = self.baseline.current, self.baseline.problem
        of_model = self.joint is None or self.baseline.dataset.machine == NEEDLE
        if self.joint is not None:
            said.insert(len(self.joint.numbers), self._of_joint(self.joint))
        if of_model and excess(problem, current.chi2) > 0.0:
            said.append(
                f"the model leaves {self.misfit:.2f} × the noise: the uncertainties hold for a model that"
                " meets the data; a diagnosis finds what it lacks"
            )
        return [*said, *(f"note: {n}" for n in self.baseline.dataset.notes)]

    def _of_joint(self, joint: JointFriction) -> str:
        lever_m = self.baseline.dataset.lever_m
        left = f"{joint.left_nm * 1e3:.3g} N·mm" if lever_m is None else f"{joint.left_nm / lever_m:.3g} N"
        return (
            "these are of torque against speed, as no twist is seen beside it; they leave"
            f" {left} (root mean square), reversals left aside"
        )

    def as_json(self) -> JsonObject:
        """As it stands in the JSON answer."""
        return {
            "dataset": self.baseline.problem.name,
            "tip": "clamped" if self.baseline.dataset.layout.tip_clamped else "free",
            "estimates": [e.as_json() for e in self.estimates],
            "misfit": round(self.misfit, 4),
            "notes": list(self.baseline.dataset.notes),
        }

    def saved(self, before: SavedModel | None, name: str, today: str | None = None) -> SavedModel:
        """The model file with these values. Those not identified stay as they were known before.

        Raises BadInput for friction of a plain joint: no model file holds torque against speed, and the
        line's own values would be those of another machine.
        """
        if self.joint is not None and self.baseline.dataset.machine != NEEDLE:
            raise BadInput(
                f"{self.baseline.problem.name}: friction of a plain joint is no model of a line, and no model"
                " file is written; leave --out and --update out, or adopt what `diagnose` finds"
            )
        problem, fitted = self.baseline.problem, self.baseline.current
        at = within_bounds(self.parameters, self.posterior.mean)
        vector = dataclasses.replace(
            fitted.vector, log_friction=at[0], log_rigidity=at[1], scaled_values=at[2:]
        )
        model = problem.model(self.parameters, vector)
        sizes = deviations_in_file_units(self.parameters, at, self.posterior.deviations)
        known = {n: s for n, s in zip(self.names, sizes.tolist(), strict=True) if 0.0 < s < np.inf}
        deviations = self.posterior.deviations
        of = self.posterior.covariance / np.outer(deviations, deviations)
        correlations = {
            (one, other): round(float(np.clip(of[i, k], -1.0, 1.0)), 6)
            for i, one in enumerate(self.names)
            for k, other in enumerate(self.names)
            if i < k and {one, other} <= known.keys()
        }
        entry = HistoryEntry(
            dataset=problem.name,
            date=today or datetime.date.today().isoformat(),
            values_before={} if before is None else before.model.values(),
            note=f"identified from {len(problem.trials)} trials",
        )
        return SavedModel(
            model=dataclasses.replace(model, name=name, element_length_m=self.baseline.fine_m),
            starts_from=before.starts_from if before else "null",
            uncertainties=known,
            history=(*(before.history if before else ()), entry),
            correlations=correlations,
        )


def identify(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None = None,
    say: Say = lambda _: None,
) -> Identification:
    """Friction, its scatter, torsional rigidity, damping and the parameters of `model` from a recording.

    `model` (default: the null model) gets damping where it has none. Raises BadInput, SolverError.
    """
    return _identified(dataset, library, model, None, say)


def update(
    dataset: Dataset, library: Mapping[str, type[Effect]], saved: SavedModel, say: Say = lambda _: None
) -> Identification:
    """The same with a model file's values and uncertainties as prior.

    Raises Contradiction where the recording is not what they predict, BadInput, SolverError.
    """
    return _identified(dataset, library, saved.model, saved, say)


def _identified(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None,
    saved: SavedModel | None,
    say: Say,
) -> Identification:
    step = numbered(say, 3)
    start = model or null_model(dataset)
    if dataset.layout.tissue_sections_m and DAMPING not in {e.name() for e in start.effects}:
        start = start.with_effects(library[DAMPING]())
    baseline = fit_baseline(dataset, start, library, in_whole_trials, say=step)
    step("separating what the data say from what was known")
    information = Information.of(baseline.problem, baseline.current)
    stated = _stated(baseline)
    alone = information.posterior(stated)
    prior = stated if saved is None else known_of(baseline.current.parameters, saved, stated)
    if saved is not None and (p := information.conflict(prior)) < CONTRADICTS:
        raise Contradiction(_contradiction(baseline, saved, prior, alone, p))
    posterior = information.posterior(prior)
    narrowed = alone.deviations < NARROWED * stated.deviations
    angles_alone = not any(t.torque_ok.any() for t in baseline.dataset.trials)
    ratio_known = angles_alone and _log_ratio(alone)[1] < NARROWED * _log_ratio(stated)[1]
    estimates = _estimates(baseline, posterior, narrowed, ratio_known)
    joint = _joint_of(dataset)
    if joint is not None:
        # what twists unseen has no rigidity: the rod's numbers would be those of another machine
        told = _told(joint, dataset.lever_m)
        estimates = told if dataset.machine != NEEDLE else (*told, *estimates)
    size = baseline.problem.size
    return Identification(
        baseline,
        information,
        posterior,
        estimates,
        float(np.sqrt(baseline.current.chi2 / max(size, 1))),
        joint,
    )


def _joint_of(dataset: Dataset) -> JointFriction | None:
    """Friction of a plain joint; None where a twist is seen or stated, or too little turns."""
    if dataset.needle.rigidity_is_known or twist_is_seen(dataset, math.radians(LEAST_TWIST_DEG)):
        return None
    return joint_friction(seen(dataset.trials))


def _told(joint: JointFriction, lever_m: float | None) -> tuple[Estimate, ...]:
    """Its numbers in N·mm and rad, or in N and mm at a lever."""
    arm_mm = 1.0 if lever_m is None else lever_m * 1e3
    torque, turn = ("N·mm", "rad") if lever_m is None else ("N", "mm")
    of = {
        "viscous": (f"{torque}·s/{turn}", 1e3 / arm_mm**2),
        "stribeck_rate": (f"{turn}/s", arm_mm),
        "inertia": (f"{torque}·s²/{turn}", 1e3 / arm_mm**2),
    }
    told = []
    for number in joint.numbers:
        unit, size = of.get(number.name, (torque, 1e3 / arm_mm))
        most = None if number.at_most is None else size * number.at_most
        if number.value is None or number.deviation is None:
            told.append(Estimate(number.name, unit, None, None, None, number.missing, most))
            continue
        value, deviation = size * number.value, size * number.deviation
        ends = (value - joint.reach * deviation, value + joint.reach * deviation)
        told.append(Estimate(number.name, unit, value, deviation, ends, at_most=most))
    return tuple(told)


def _stated(baseline: Baseline) -> Gaussian:
    """What is known without any recording: the stated rigidity, and sizes that effects have."""
    problem, parameters = baseline.problem, baseline.current.parameters
    centre = np.r_[
        np.log(problem.base.torque_scale * FRICTIONS_N[2]),
        np.log(problem.base.torsional_rigidity_nm2),
        np.zeros(len(parameters)),
    ]
    widths = np.r_[UNKNOWN_SIGMA, problem.rigidity_prior, [p.prior_sd for p in parameters]]
    return Gaussian(centre, np.diag(widths**2))


def _contradiction(baseline: Baseline, saved: SavedModel, prior: Gaussian, alone: Gaussian, p: float) -> str:
    """What differs most, as a sentence."""
    parameters = baseline.current.parameters
    names = shared_names(parameters)
    away = (alone.mean - prior.mean) / np.hypot(alone.deviations, prior.deviations)
    worst = int(np.argmax(np.abs(away)))
    here, there = (
        in_file_units(parameters, within_bounds(parameters, g.mean))[worst] for g in (alone, prior)
    )
    return (
        f"{baseline.problem.name}: contradicts {saved.model.name} ({spelt_p(p)}, limit {CONTRADICTS:g}):"
        f" {names[worst]} is {here:.4g} here and {there:.4g} there, {abs(away[worst]):.1f} standard"
        " deviations apart; the model file is unchanged: identify these data without it for values of their"
        " own"
    )


def _estimates(
    baseline: Baseline, posterior: Gaussian, narrowed: npt.NDArray[np.bool_], ratio_known: bool
) -> tuple[Estimate, ...]:
    current, layout = baseline.current, baseline.dataset.layout
    parameters = current.parameters
    dof = current.scatter_dof - 1.0
    # a trial's friction differs by a scatter that is itself estimated
    reach = np.full(posterior.mean.size, float(ndtri(0.5 + CONFIDENCE / 2)))
    reach[0] = float(stdtrit(dof, 0.5 + CONFIDENCE / 2))
    at = within_bounds(parameters, posterior.mean)
    values = in_file_units(parameters, at)
    sizes = deviations_in_file_units(parameters, at, posterior.deviations)
    ends = [
        in_file_units(parameters, within_bounds(parameters, _truncated(parameters, posterior, s * reach)))
        for s in (-1, 1)
    ]
    names, units = shared_names(parameters), shared_units(parameters)
    found = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        if i == 0 and not layout.tissue_sections_m:
            experiment = (
                "the needle is in no tissue: insert it and turn the base until the torque no longer rises"
            )
            found.append(Estimate(name, unit, None, None, None, experiment))
        elif narrowed[i]:
            low, high = sorted((float(ends[0][i]), float(ends[1][i])))
            found.append(Estimate(name, unit, float(values[i]), float(sizes[i]), (low, high)))
        else:
            found.append(Estimate(name, unit, None, None, None, _experiment(name, baseline, ratio_known)))
    if ratio_known and layout.tissue_sections_m:
        # by their logarithms: the product of two numbers, of which the recording tells neither
        log, size = _log_ratio(posterior)
        low, value, high = np.exp(log + size * reach[0] * np.array([-1.0, 0.0, 1.0])) * (
            values[0] / values[1] / np.exp(at[0] - at[1])
        )
        found.append(
            Estimate(RATIO, "rad/mm per 100 mm", float(value), float(size * value), (float(low), float(high)))
        )
    return (*found, _scatter(baseline, dof))


def _log_ratio(of: Gaussian) -> tuple[float, float]:
    """Logarithm of friction over torsional rigidity, and its standard deviation."""
    covariance = of.covariance
    variance = covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]
    return float(of.mean[0] - of.mean[1]), float(np.sqrt(max(variance, 0.0)))


def _scatter(baseline: Baseline, dof: float) -> Estimate:
    """Relative scatter of friction from trial to trial; its posterior is a scaled inverse χ²."""
    current, trials = baseline.current, len(baseline.problem.trials)
    prior_dof = POLICY.noise.scatter_dof
    if trials - 1 < prior_dof or not baseline.dataset.layout.tissue_sections_m:
        return Estimate(
            SCATTER,
            "%",
            None,
            None,
            None,
            f"repeat a command until there are {prior_dof + 1:g} trials or more in tissue, here are {trials}",
        )
    value = current.scatter * float(np.sqrt(current.scatter_dof / dof))
    ends = (0.5 + CONFIDENCE / 2, 0.5 - CONFIDENCE / 2)
    low, high = (float(value * np.sqrt(dof / chdtri(dof, 1.0 - q))) for q in ends)
    return Estimate(SCATTER, "%", 100 * value, 100 * value / float(np.sqrt(2 * dof)), (100 * low, 100 * high))


def _experiment(name: str, baseline: Baseline, ratio_known: bool) -> str:
    """What would give a parameter that the recording does not narrow."""
    torque = any(t.torque_ok.any() for t in baseline.dataset.trials)
    angle = any(t.hall_ok.any() for t in baseline.dataset.trials)
    line = "needle" if baseline.dataset.machine == NEEDLE else "line"
    if name in (FRICTION, TORSIONAL_RIGIDITY) and not torque:
        if ratio_known:
            return f"angles alone give {RATIO}: record the base torque beside them"
        return f"turn the base until the {line} slips below a sensor, and record the base torque beside it"
    if name == TORSIONAL_RIGIDITY and not angle:
        return (
            "record an angle beyond the first tissue beside the torque, or clamp the tip and turn the base by"
            " 90° (rig: tip: clamped)"
        )
    if name == TORSIONAL_RIGIDITY:
        if baseline.dataset.needle.rigidity_is_known:
            return (
                "it is stated more precisely than this recording tells: clamp the tip and turn the base by"
                " 90°"
            )
        return (
            "the shaft twists too little beside the noise: wind it farther, or clamp the tip and turn the"
            " base by 90° (rig: tip: clamped)"
        )
    if name == FRICTION:
        return "turn the base until the torque no longer rises, one way and back"
    if name.startswith(DAMPING):
        return "turn at two rates or more, a factor of five apart, until the torque no longer rises"
    return "turn to and fro with several targets, rates and dwells"


def _truncated(parameters: Sequence[FreeParameter], posterior: Gaussian, reach: Array) -> Array:
    """Ends (p,) at `reach` standard deviations; with the mean beyond a bound, a quantile of what is inside.

    So an effect that is off has an upper end, whatever side of nothing the data lie on.
    """
    ends = posterior.mean + reach * posterior.deviations
    for i, parameter in enumerate(parameters, start=2):
        low, high = ((b - posterior.mean[i]) / posterior.deviations[i] for b in parameter.bounds)
        for bound, side in ((low, 1.0), (high, -1.0)):
            if reach[i] * side > 0.0 and side * bound > 0.0:
                # the mean lies outside: the tail beyond the bound is all that is possible
                tail = float(ndtr(-side * bound) * ndtr(-abs(reach[i])))
                ends[i] = posterior.mean[i] + side * posterior.deviations[i] * -float(ndtri(tail))
    return np.asarray(ends)
