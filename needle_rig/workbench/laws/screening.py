"""What each law promises on top of a fit: one linearised fit of its curve, with all else profiled out.

Each function is a task: it takes what a search shares, and gives what can be sent back.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.torque_scale import torque_power
from needle_rig.units import rad
from needle_rig.workbench.estimation.derivatives import directional_derivatives
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.posterior import STEP, Objective
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.laws.law import UNIT, Law, every_law
from needle_rig.workbench.laws.spline import Quadratic, Spline, smoothed
from needle_rig.workbench.laws.spline_effect import SplineLaw, of_place, of_trial

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
PLAY_KNOTS, PLAY_POINTS = 5, 21
"""The same of where a reading stands in a play, near a line; points of it that count as seen."""
TYPICAL = {"N·mm per 100 mm": 0.05, "N·mm": 0.005, "°": 2.0, "1": 0.3}
"""Size of a curve, in its unit, about which amplitudes are tried: the library's typical sizes."""
WIDENED = 0.03
"""Share by which a range seen in the data is widened, so that noise does not leave it."""
SCREENING_STEP = 30.0
"""Times the typical size for a linearised curve: its derivatives then step by a tenth of that size."""
GIVE_DEG = 1.0
"""Angle that all tissue gives where a stiffness is linearised."""
DRAG_SHARE = 0.4
"""Times the typical size, the drag at the largest rate about which a torque on the rate is linearised."""
MOST_AMPLITUDE = 8.0
"""Times the typical size that a curve's amplitude may have in its first fit."""


FIRST_ROUGHNESS = 0.3
"""Roughness that a curve has at most in its first fits, from smooth to rough: a fit that begins with a rough
curve ends in a minimum of its own."""


@dataclass(frozen=True)
class Screened:
    """What a linearised curve promises on top of a fit."""

    made: SplineLaw
    gain: float
    """Twice the logarithm of the restricted likelihood, over that without the law."""
    coefficients: Array


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
            OF_TRIALS if single else PLAY_KNOTS if law.kind == "play" else KNOTS[law.variable],
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
    if not values.size:  # of a channel that was not recorded
        return 0.0, 0.0
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
    if law.kind == "play":
        half = 0.5 * rad(law.play_deg)
        return np.linspace(-half, half, PLAY_POINTS)
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
    return _finite(np.concatenate([of_trial(law, b.trial) for b in trials]))


def _finite(values: Array) -> Array:
    return np.asarray(values[np.isfinite(values)])


def screen(given: Problem, parent: Fit, made: SplineLaw) -> Screened | None:
    """What the law promises: the residuals projected on the coefficients' derivatives, where it begins."""
    problem = given.with_effects(made.effect())
    names = (*parent.effects, made.name)
    parameters = problem.parameters(names)
    begin = made.scaled_values(beginning(problem, made))
    scaled_values = np.r_[parent.vector.scaled_values, begin]
    state = Objective(problem, parameters, scaled_values)
    x = state.packed(dataclasses.replace(parent.vector, scaled_values=scaled_values), parent.nuisance)
    residuals = state.residuals(x) if begin.any() else list(parent.residuals)
    if residuals is None:
        return None
    if made.law.hook == "observe":
        columns: list[Array] | None = _reading_columns(problem, parent, made)
    else:
        columns = _moving_columns(state, x, residuals, made.spline.count)
    if columns is None:
        return None
    known = len(parent.parameters) + 2
    jacobians = [
        np.column_stack([j[:, :known], c, j[:, known:]])
        for j, c in zip(parent.jacobians, columns, strict=True)
    ]
    linear = LinearisedFit.at(problem, parameters, x, residuals, jacobians, parent.scatter**-2)
    inner = profiled(linear, made.spline.count)
    if not (np.isfinite(inner.G).all() and np.isfinite(inner.b).all()):
        return None
    of_coefficients, unit = inner.scaled(made.spline.inverse), typical(problem, made.law)
    _, gain, _ = smoothed(made.spline, of_coefficients, unit)
    spread = np.asarray(np.linalg.inv(np.eye(made.spline.count) + inner.G))
    missed = dispersion(residuals, columns, spread)
    spline, _, coefficients = smoothed(made.spline, of_coefficients.over(missed), unit, FIRST_ROUGHNESS)
    # what is stuck does not move until it slips: derivatives then ask for curves that are far too large
    most = MOST_AMPLITUDE * unit
    spline = dataclasses.replace(spline, amplitude=min(spline.amplitude, most))
    return Screened(dataclasses.replace(made, spline=spline), gain, coefficients)


def dispersion(residuals: Sequence[Array], columns: Sequence[Array], spread: Array) -> float:
    """Variance of whitened residuals (n,) a trial over that of the noise, where it is larger.

    Values count by their leverage on parameters of these derivatives (n, k) and this covariance (k, k). What
    a model misses there, and what a linearised curve cannot tell of a law that is not linear, would pass for
    roughness of a curve, and its band would be too narrow (quasi-likelihood: McCullagh, Nelder, Generalized
    Linear Models (1989), sec. 4.5; by leverage it is the sandwich's: White, Econometrica 48 (1980)).
    """
    left, slopes = np.concatenate(list(residuals)), np.concatenate(list(columns))
    leverage = ((slopes @ spread) * slopes).sum(axis=1)
    return max(1.0, float(leverage @ left**2) / max(float(leverage.sum()), 1e-300))


def beginning(problem: Problem, made: SplineLaw) -> Array:
    """Coefficients (K,) about which a law is linearised: none, but of stiffness and of a torque on the rate.

    Tissue cannot give less than nothing, and dry friction with a torque that grows with the rate has no
    balance: some give, and a drag, leave room for steps to both sides.
    """
    if made.law.place == "stiffness":
        return np.full(made.spline.count, GIVE_DEG)
    if made.law.hook != "torque" or made.law.variable != "rate":
        return np.zeros(made.spline.count)
    centres = made.spline.low + made.spline.spacing * (np.arange(made.spline.count) - 1)
    largest = max(abs(made.spline.low), abs(made.spline.high))
    return np.asarray(-DRAG_SHARE * typical(problem, made.law) * centres / largest)


def _moving_columns(state: Objective, x: Array, residuals: list[Array], count: int) -> list[Array] | None:
    """Derivatives of the whitened model (n, count) a trial by a law that moves the needle."""
    rows = np.concatenate(residuals)

    def left(moved: Array) -> Array | None:
        after = state.residuals(moved)
        return None if after is None else np.concatenate(after)

    directions = np.eye(state.p, x.size)[state.p - count :]
    found = directional_derivatives(left, x, rows, directions, np.full(count, STEP), state.low, state.high)
    if found is None:
        return None
    return np.split(-found, np.cumsum([r.size for r in residuals])[:-1])


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
