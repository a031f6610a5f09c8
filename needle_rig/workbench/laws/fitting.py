"""Curves of laws against data: screened by one linearised fit, fitted inside the solver, judged.

Each function is a task: it takes what a search shares, and gives what can be sent back.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import load_effect
from needle_rig.physics.torque_scale import torque_power
from needle_rig.workbench.estimation.cross_validation import CrossValidation, cross_validate
from needle_rig.workbench.estimation.derivatives import directional_derivatives
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.map_fit import Fit, fit
from needle_rig.workbench.estimation.posterior import STEP, Objective, start_vector, sum_of_squares
from needle_rig.workbench.estimation.problem import ParameterVector, Problem
from needle_rig.workbench.laws.formulas import Formula
from needle_rig.workbench.laws.law import UNIT, Law, every_law
from needle_rig.workbench.laws.spline import Quadratic, Spline, smoothed
from needle_rig.workbench.laws.spline_effect import SplineLaw, of_place, of_trial
from needle_rig.workbench.selection.search import penalty

KNOTS = {
    "angle": 16,
    "base_angle": 16,
    "twist": 13,
    "torque": 11,
    "rate": 10,
    "travel": 11,
    "stop_time": 10,
    "clock": 10,
    "trial": 6,
    "direction": 5,
    "x": 20,
}
"""Coefficients of a spline: more than a curve that these data can show needs. The data set the smoothness."""
ALONG_M = 1e-3
"""Distance of the places along the needle that count as seen."""
OF_TRIALS = 6
"""Coefficients where the variable has one value a trial."""
TYPICAL = {"N·mm per 100 mm": 0.05, "N·mm": 0.005, "°": 2.0, "1": 0.3}
"""Size of a curve, in its unit, about which amplitudes are tried: the library's typical sizes."""
WIDENED = 0.03
"""Share by which a range seen in the data is widened, so that noise does not leave it."""
SCREENING_STEP = 30.0
"""Times the typical size for a linearised curve: its derivatives then step by a tenth of that size."""
SHARES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Shares of a linearised curve at which a fit may start: of dry friction it says too much."""
FIRST_ITERATIONS = 4
MOST_AMPLITUDE = 8.0
"""Times the typical size that a curve's amplitude may have in its first fit."""
FAR = 3.0
"""A present model that misses by more than this bends its constants: fits start from the stated ones, too."""


@dataclass(frozen=True)
class FormulaLaw:
    """A law with a formula, in an effect file."""

    law: Law
    path: Path
    formula: Formula
    """As it was drafted: a fit moves its numbers."""

    @property
    def name(self) -> str:
        """Of the effect: that of the file."""
        return self.path.stem

    def effect(self) -> type[Effect]:
        """The effect. Raises BadInput where the file is none."""
        return load_effect(self.path)


Made = SplineLaw | FormulaLaw


@dataclass(frozen=True)
class Shared:
    """What all tasks of a search need; effects that were made are made again where a task runs."""

    problem: Problem
    made: tuple[Made, ...] = ()

    def with_made(self, *further: Made) -> Problem:
        """The problem, its library with all effects that were made."""
        effects = {each.name: each.effect() for each in (*self.made, *further)}
        return dataclasses.replace(self.problem, library={**self.problem.library, **effects})


@dataclass(frozen=True)
class Screened:
    """What a linearised curve promises on top of a fit."""

    made: SplineLaw
    gain: float
    """Twice the logarithm of the restricted likelihood, over that without the law."""
    coefficients: Array


@dataclass(frozen=True)
class LawFit:
    """A law fitted with all else."""

    made: Made
    fit: Fit
    validation: CrossValidation
    score: float
    """−2 log likelihood with the curve integrated out, or the objective with its price; lower is better."""
    quadratic: Quadratic | None = None
    """Of a spline's coefficients."""
    coefficients: Array | None = None
    covariance: Array | None = None
    """Of the same (K, K)."""

    @property
    def law(self) -> Law:
        """Where and on what."""
        return self.made.law


def present_score(problem: Problem, found: Fit) -> float:
    """Of a fit without further laws, on the scale of `LawFit.score`."""
    return found.objective + penalty(problem) * found.rank


def candidates(problem: Problem, prefix: str) -> tuple[SplineLaw, ...]:
    """Every law with a spline over the range that its variable has in the data."""
    layout = problem.base.layout
    found = []
    for law in every_law(len(layout.sensor_positions_m), len(layout.tissue_sections_m)):
        low, high = _range(problem, law)
        unit = UNIT[law.variable_unit][2]
        room = WIDENED * (high - low)
        if not room > 0.0:
            continue
        single = law.hook == "shape" and law.variable != "x"
        spline = Spline(
            float((low - room) / unit),
            float((high + room) / unit),
            OF_TRIALS if single else KNOTS[law.variable],
            SCREENING_STEP * typical(problem, law),
            np.inf,
        )
        found.append(SplineLaw(law, spline, f"{prefix}_{law.name}"))
    return tuple(found)


def typical(problem: Problem, law: Law) -> float:
    """Size about which the curve's amplitude is sought; in one section a torque needs more to be seen."""
    size = TYPICAL[law.unit] * problem.base.torque_scale ** torque_power(law.unit)
    sections = problem.base.layout.tissue_sections_m
    if law.hook == "torque" and law.number is not None:
        start_m, end_m = sections[law.number]
        size *= sum(end - start for start, end in sections) / (end_m - start_m)
    return size


def _range(problem: Problem, law: Law) -> tuple[float, float]:
    """Smallest and largest value of the variable in the data, SI."""
    layout = problem.base.layout
    if law.variable == "x":
        sections = layout.tissue_sections_m
        ends = (0.0, layout.needle_length_m) if law.place == "rigidity" else (sections[0][0], sections[-1][1])
        return float(ends[0]), float(ends[1])
    values = seen(problem, law)
    return float(values.min()), float(values.max())


def seen(problem: Problem, law: Law) -> Array:
    """All values of the variable in the data, SI; of the tissue's angle those of base and sensors."""
    trials = problem.trials
    if law.hook == "shape" and law.variable != "x":
        return np.array([of_place(law.variable, b.trial) for b in trials])
    if law.variable == "x":
        layout = problem.base.layout
        parts = ((0.0, layout.needle_length_m),) if law.place == "rigidity" else layout.tissue_sections_m
        return np.concatenate([np.arange(start, end, ALONG_M) for start, end in parts])
    measured = [b.mean for b in trials]
    if law.variable == "torque":
        return _finite(np.concatenate([m[0] for m in measured]))
    if law.variable in ("angle", "twist"):
        rows = (
            range(1, measured[0].shape[0])
            if law.number is None or law.hook == "torque"
            else (law.number + 1,)
        )
        halls = [m[list(rows)] for m in measured]
        if law.variable == "twist":
            driven = [b.averaged(np.tile(b.trial.base_angle_rad, (len(b.averages), 1))) for b in trials]
            halls = [h - d[list(rows)] for h, d in zip(halls, driven, strict=True)]
        values = [h.ravel() for h in halls]
        base = [b.trial.base_angle_rad for b in trials] if law.hook == "torque" else []
        return _finite(np.concatenate([*values, *base]))
    return _finite(np.concatenate([of_trial(law.variable, b.trial) for b in trials]))


def _finite(values: Array) -> Array:
    return np.asarray(values[np.isfinite(values)])


def screen(shared: Shared, parent: Fit, made: SplineLaw) -> Screened | None:
    """What the law promises: the parent's residuals projected on the coefficients' derivatives."""
    problem = shared.with_made(made)
    names = (*parent.effects, made.name)
    parameters = problem.parameters(names)
    state = Objective(problem, parameters)
    scaled_values = np.r_[parent.vector.scaled_values, np.zeros(made.spline.count)]
    x = state.packed(dataclasses.replace(parent.vector, scaled_values=scaled_values), parent.nuisance)
    if made.law.hook == "observe":
        columns: list[Array] | None = _reading_columns(problem, parent, made)
    else:
        columns = _moving_columns(state, x, parent, made.spline.count)
    if columns is None:
        return None
    known = len(parent.parameters) + 2
    jacobians = [
        np.column_stack([j[:, :known], c, j[:, known:]])
        for j, c in zip(parent.jacobians, columns, strict=True)
    ]
    linear = LinearisedFit.at(problem, parameters, x, parent.residuals, jacobians, parent.scatter**-2)
    inner = profiled(linear, made.spline.count)
    if not (np.isfinite(inner.G).all() and np.isfinite(inner.b).all()):
        return None
    of_coefficients = inner.scaled(made.spline.inverse)
    spline, gain, coefficients = smoothed(made.spline, of_coefficients, typical(problem, made.law))
    # what is stuck does not move until it slips: derivatives then ask for curves that are far too large
    most = MOST_AMPLITUDE * typical(problem, made.law)
    spline = dataclasses.replace(spline, amplitude=min(spline.amplitude, most))
    return Screened(dataclasses.replace(made, spline=spline), gain, coefficients)


def _moving_columns(state: Objective, x: Array, parent: Fit, count: int) -> list[Array] | None:
    """Derivatives of the whitened model (n, count) a trial by a law that moves the needle."""
    rows = np.concatenate(parent.residuals)

    def left(moved: Array) -> Array | None:
        after = state.residuals(moved)
        return None if after is None else np.concatenate(after)

    directions = np.eye(state.p, x.size)[state.p - count :]
    found = directional_derivatives(left, x, rows, directions, np.full(count, STEP), state.low, state.high)
    if found is None:
        return None
    return np.split(-found, np.cumsum([r.size for r in parent.residuals])[:-1])


def _reading_columns(problem: Problem, parent: Fit, made: SplineLaw) -> list[Array]:
    """The same by a law of the readings, which are linear in it: nothing is solved but the parent's model."""
    law, columns = made.law, []
    factor = UNIT[law.unit][2]
    for t, (binned, whiten) in enumerate(zip(problem.trials, problem.whiteners, strict=True)):
        reading = problem.model(parent.parameters, parent.vector, t).predict(binned.trial)
        changes = np.zeros((*binned.mean.shape, made.spline.count))
        if law.place == "torque":
            changes[0] = binned.averages[0] @ made.on(reading, None)
        else:
            for k in range(reading.hall_rad.shape[1]) if law.number is None else (law.number,):
                changes[1 + k] = binned.averages[1 + k] @ made.on(reading, k)
        columns.append(whiten(factor * changes @ made.spline.root))
    return columns


def profiled(linear: LinearisedFit, count: int) -> Quadratic:
    """−2 log likelihood as a function of the last `count` scaled values, all else profiled out."""
    inside = np.arange(linear.p - count, linear.p)
    outside = np.setdiff1d(np.arange(linear.precision.size), inside)
    curvature, descent = linear.curvature + linear.level, linear.descent
    prior, at = linear.precision[inside], linear.from_centre[inside]
    cross = curvature[np.ix_(inside, outside)]
    rest = curvature[np.ix_(outside, outside)] + 1e-9 * np.eye(outside.size)
    solved = np.linalg.solve(rest, np.column_stack([cross.T, descent[outside]]))
    G = curvature[np.ix_(inside, inside)] - np.diag(prior) - cross @ solved[:, :-1]
    b = descent[inside] + prior * at - cross @ solved[:, -1] + G @ at
    # differences of finite steps leave it not quite positive
    values, vectors = np.linalg.eigh(0.5 * (G + G.T))
    return Quadratic((vectors * np.maximum(values, 0.0)) @ vectors.T, b)


def fit_spline(shared: Shared, parent: Fit, screened: Screened, whole: bool) -> LawFit | None:
    """The law's curve fitted with all else: a few steps, its smoothness anew, and with `whole` to the end."""
    problem = shared.with_made(screened.made)
    best: Fit | None = None
    for start in _starts(problem, parent, screened):
        found = fit(
            problem,
            (*parent.effects, screened.made.name),
            start,
            nuisance=parent.nuisance,
            iterations=FIRST_ITERATIONS,
            tolerance=0.5,
        )
        if found is not None and (best is None or found.objective < best.objective):
            best = found
    if best is None:
        return None
    made, count = screened.made, screened.made.spline.count
    if whole:
        inner = profiled(LinearisedFit.of(problem, best), count)
        of_coefficients = inner.scaled(made.spline.inverse)
        spline, _, _ = smoothed(made.spline, of_coefficients, typical(problem, made.law))
        again = dataclasses.replace(made, spline=spline)
        z = again.scaled_values(made.coefficients(best.vector.scaled_values[-count:]))
        scaled_values = np.r_[best.vector.scaled_values[:-count], z]
        problem = shared.with_made(again)
        vector = dataclasses.replace(best.vector, scaled_values=scaled_values)
        refined = fit(problem, best.effects, vector, nuisance=best.nuisance)
        if refined is None:
            return None
        made, best = again, refined
    return _judged(problem, parent, made, best, whole)


def _judged(problem: Problem, parent: Fit, made: SplineLaw, found: Fit, whole: bool) -> LawFit:
    count, root = made.spline.count, made.spline.root
    inner = profiled(LinearisedFit.of(problem, found), count)
    occam = float(np.linalg.slogdet(np.eye(count) + inner.G)[1])
    nothing = CrossValidation(float("inf"), float("inf"), ())
    return LawFit(
        made,
        found,
        cross_validate(problem, found) if whole else nothing,
        found.objective + occam + penalty(problem) * parent.rank,
        inner.scaled(made.spline.inverse),
        made.coefficients(found.vector.scaled_values[-count:]),
        np.asarray(root @ found.covariance[-count:, -count:] @ root.T),
    )


def _starts(problem: Problem, parent: Fit, screened: Screened) -> list[ParameterVector]:
    """The best share of the linearised curve from where the parent is; where that is far off, also from the
    stated constants."""
    parameters = problem.parameters((*parent.effects, screened.made.name))
    state = Objective(problem, parameters)
    z = screened.made.scaled_values(screened.coefficients)
    vectors = [parent.vector]
    if parent.chi2 > FAR * problem.size:
        stated = start_vector(problem, parent.vector.log_friction)
        vectors.append(dataclasses.replace(stated, scaled_values=parent.vector.scaled_values))
    starts = []
    for vector in vectors:
        rated: list[tuple[float, int, ParameterVector]] = []
        for number, share in enumerate(SHARES):
            start = dataclasses.replace(vector, scaled_values=np.r_[vector.scaled_values, share * z])
            x = state.packed(start, parent.nuisance)
            rows = state.residuals(x)
            if rows is not None:
                rated.append((sum_of_squares(rows) + state.prior(x), number, start))
        if rated:
            starts.append(min(rated, key=lambda r: r[:2])[2])
    return starts


def fit_formula(
    shared: Shared, parent: Fit, starts: tuple[ParameterVector, ...], made: FormulaLaw
) -> LawFit | None:
    """A formula fitted in the place of a spline, from several vectors of all but its own parameters."""
    problem = shared.with_made(made)
    names = (*parent.effects, made.name)
    own = problem.parameters([made.name])
    at = np.array([a.scaled_value(a.info.typical) for a in own])
    best: Fit | None = None
    for start in starts:
        vector = dataclasses.replace(start, scaled_values=np.r_[start.scaled_values, at])
        found = fit(problem, names, vector, nuisance=parent.nuisance)
        if found is not None and (best is None or found.objective < best.objective):
            best = found
    if best is None:
        return None
    price = penalty(problem) * (parent.rank + len(own))
    return LawFit(made, best, cross_validate(problem, best), best.objective + price)


def from_task(found: list[Any]) -> list[Any]:
    """Without what could not be solved."""
    return [each for each in found if each is not None]
