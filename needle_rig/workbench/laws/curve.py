"""A law's curve with its uncertainty, where data are and where they are not."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.posterior import STEP
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.laws.formulas import Formula
from needle_rig.workbench.laws.halves import where_seen
from needle_rig.workbench.laws.law import UNIT
from needle_rig.workbench.laws.law_search import FoundLaw, misses_more
from needle_rig.workbench.laws.screening import dispersion, seen
from needle_rig.workbench.laws.spline_effect import SplineLaw

BAND_SIGMAS = 1.96
CURVE_POINTS = 121


@dataclass(frozen=True, eq=False)
class Curve:
    """A fitted curve at points `at` (n,), all in the units of the law."""

    at: Array
    value: Array
    low: Array
    """95 % band."""
    high: Array
    data: Array
    """How many values of the variable the data have nearest to each vector."""
    halves: tuple[Array, ...]
    """The same curve from halves of the trials; NaN outside the range of their data."""


def fitted_curve(problem: Problem, current: Fit, found: FoundLaw, formula: Formula | None) -> Curve:
    """The curve of a law of a fit with its band, and the spline's from halves of the trials.

    It is the spline's, which takes no form for granted; where the data see that a spline is not sharp
    enough for the law, the formula's. A spline is smoothed at a kink and an edge, and a formula is one form
    of several that the data bear: with a formula the band is the envelope of both curves' 95 % bands. A
    factor's band is that of its logarithm.
    """
    spline = found.spline
    assert isinstance(spline.made, SplineLaw)
    assert spline.coefficients is not None
    assert spline.covariance is not None
    family = spline.made.spline
    at = np.linspace(family.low, family.high, CURVE_POINTS)
    basis = family.basis(at)
    coefficients = spline.coefficients
    if formula is None:
        # as all laws were last fitted together
        own = [each.effect == spline.made.name for each in current.parameters]
        coefficients = spline.made.coefficients(current.vector.scaled_values[own])
    there = seen(problem, spline.law) / UNIT[spline.law.variable_unit][2]
    step = at[1] - at[0]
    data, _ = np.histogram(there, bins=np.r_[at - step / 2, at[-1] + step / 2])
    linked, unlinked = spline.made.linked, spline.made.unlinked
    level = 0.0
    if spline.law.place == "slip_limit":
        # a constant factor is friction: the mean is none's, or the formula's
        # (centred smooths: Wood, Generalized Additive Models (2017), sec. 5.4.1)
        mean = data / data.sum()
        basis = basis - mean @ basis
        level = 0.0 if formula is None else float(mean @ unlinked(formula.at(at)))
    values, spread = level + basis @ coefficients, np.sqrt(((basis @ spline.covariance) * basis).sum(axis=1))
    value, low, high = (linked(each) for each in (values, *_band(values, spread)))
    if formula is not None:
        stated = formula.at(at)
        spread = _formula_spread(current, found.best.made.name, formula, at)
        stated, lower, upper = (linked(unlinked(each)) for each in (stated, *_band(stated, spread)))
        low, high = np.minimum(low, lower), np.maximum(high, upper)
        value = stated if misses_more(spline, found.best) else value
    halves = [linked(level + basis @ c) for c in _from_halves(problem, found)]
    shown = where_seen(problem, spline.law, at, halves, seen)
    return Curve(at, value, low, high, data, shown)


def _from_halves(given: Problem, found_law: FoundLaw) -> list[Array]:
    """The spline's coefficients from every other trial of each command, and from the others."""
    spline = found_law.spline
    assert isinstance(spline.made, SplineLaw)
    problem = given.with_effects(spline.made.effect())
    count, found = spline.made.spline.count, []
    for half in (0, 1):
        trials = [t for t in range(len(problem.trials)) if t % 2 == half]
        if len(trials) <= 1:
            continue
        vector = spline.fit.vector
        start = dataclasses.replace(vector, trial_friction=vector.trial_friction[trials])
        again = fit(problem.over([problem.trials[t] for t in trials]), spline.fit.effects, start)
        if again is not None:
            found.append(spline.made.coefficients(again.vector.scaled_values[-count:]))
    return found


def _band(value: Array, spread: Array) -> tuple[Array, Array]:
    """95 % of a curve (n,), of its standard deviation (n,)."""
    half = BAND_SIGMAS * np.nan_to_num(spread)
    return value - half, value + half


def _formula_spread(found: Fit, name: str, formula: Formula, at: Array) -> Array:
    """Standard deviation (n,) of a formula's curve, from that of its numbers by the delta method."""
    own = [i for i, each in enumerate(found.parameters) if each.effect == name][: len(formula.values)]
    here, columns = formula.at(at), []
    for place, i in enumerate(own):
        parameter, scaled = found.parameters[i], float(found.vector.scaled_values[i])
        values = list(formula.values)
        values[place] = parameter.value(scaled + STEP)
        columns.append((dataclasses.replace(formula, values=tuple(values)).at(at) - here) / STEP)
    slopes, places = np.column_stack(columns), 2 + np.array(own)
    covariance = found.covariance[np.ix_(places, places)]
    covariance = dispersion(found.residuals, [j[:, places] for j in found.jacobians], covariance) * covariance
    return np.asarray(np.sqrt(((slopes @ covariance) * slopes).sum(axis=1)))
