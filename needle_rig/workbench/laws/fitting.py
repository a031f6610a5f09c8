"""Laws fitted inside the solver with all else: splines for a few steps and to the end, formulas, held out.

Each function is a task: it takes what a search shares, and gives what can be sent back.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.cross_validation import CrossValidation, cross_validate
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.map_fit import OBJECTIVE_TOLERANCE, ROUGH, fit
from needle_rig.workbench.estimation.posterior import Objective, excess, start_vector, sum_of_squares
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem
from needle_rig.workbench.laws.law import UNIT, Law
from needle_rig.workbench.laws.made import FormulaLaw, Made
from needle_rig.workbench.laws.screening import (
    FIRST_ROUGHNESS,
    Screened,
    beginning,
    dispersion,
    profiled,
    typical,
)
from needle_rig.workbench.laws.spline import Quadratic, covariance_about, smoothed
from needle_rig.workbench.laws.spline_effect import SplineLaw
from needle_rig.workbench.selection.candidates import penalty, score

SHARES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Shares of a linearised curve at which a fit may start: of dry friction it says too much."""
FIRST_STEPS, FURTHER_STEPS, WHOLE_STEPS = 2, 3, 25
"""Gauss–Newton steps of a first fit, of one that goes on with its smoothness estimated again, and of one to
the end, where it does not end before."""
MOST_ESTIMATES = 3
"""Times that the smoothness is estimated in a fit to the end, which moves it in turn."""
FAR = 3.0
"""Mean square residual, in units of the noise's, beyond which a present model bends its constants and does
not say where a law is: fits start from the stated ones and from single sections, too."""
SECTION_SIZES = (-10.0, -3.0, 3.0, 10.0)
"""Times the typical size that a law has where it begins in one section alone."""
POINTS, LEAST_SHARE = 240, 0.01
"""Points at which a spline is laid on a formula, and the amplitude that it has at least, of the typical."""
NOT_HELD_OUT = CrossValidation(float("inf"), float("inf"), ())


@dataclass(frozen=True)
class LawFit:
    """A law fitted with all else."""

    made: Made
    fit: Fit
    score: float
    """Of the fit, with the curve integrated out; lower is better."""
    price: float = 0.0
    """What the curve's freedom costs in that; of a formula those of its numbers that the data do not see: it
    states them, too."""
    validation: CrossValidation = NOT_HELD_OUT
    quadratic: Quadratic | None = None
    """Of a spline's coefficients."""
    coefficients: Array | None = None
    covariance: Array | None = None
    """Of the same (K, K)."""

    @property
    def law(self) -> Law:
        """Where and on what."""
        return self.made.law


def first_fit(given: Problem, parent: Fit, screened: Screened) -> LawFit | None:
    """The law's curve fitted with all else for a few steps."""
    problem, made = given.with_effects(screened.made.effect()), screened.made
    best: Fit | None = None
    for starts in _starts(problem, parent, screened):
        for start in starts:
            found = fit(
                problem,
                (*parent.effects, made.name),
                start,
                nuisance=parent.nuisance,
                iterations=FIRST_STEPS,
                tolerance=ROUGH,
            )
            if found is not None:
                break
        if found is not None and (best is None or found.objective < best.objective):
            best = found
    return None if best is None else _scored(problem, made, best)


def further_fit(given: Problem, rough: LawFit, whole: bool) -> LawFit | None:
    """A first fit gone on with, its smoothness estimated again; with `whole` to the end."""
    problem, found = given.with_effects(rough.made.effect()), rough
    if not whole:
        return _gone_on(problem, rough, FIRST_ROUGHNESS, FURTHER_STEPS, ROUGH)
    for _ in range(MOST_ESTIMATES):
        after = _gone_on(problem, found, math.inf, WHOLE_STEPS, OBJECTIVE_TOLERANCE)
        if after is None:
            break
        gained, found = found.score - after.score, after
        if gained < ROUGH:
            break
    return None if found is rough else found


def _gone_on(given: Problem, rough: LawFit, roughest: float, steps: int, tolerance: float) -> LawFit | None:
    made, quadratic = rough.made, rough.quadratic
    assert isinstance(made, SplineLaw)
    assert quadratic is not None
    count = made.spline.count
    spline, _, _ = smoothed(made.spline, quadratic, typical(given, made.law), roughest)
    again = dataclasses.replace(made, spline=spline)
    vector = rough.fit.vector
    z = again.scaled_values(made.coefficients(vector.scaled_values[-count:]))
    problem = given.with_effects(again.effect())
    # the same curves in other units: their derivatives are known
    own = slice(2 + len(rough.fit.parameters) - count, 2 + len(rough.fit.parameters))
    change = made.spline.inverse @ spline.root
    jacobians = []
    for each in rough.fit.jacobians:
        moved = each.copy()
        moved[:, own] = each[:, own] @ change
        jacobians.append(moved)
    found = fit(
        problem,
        rough.fit.effects,
        dataclasses.replace(vector, scaled_values=np.r_[vector.scaled_values[:-count], z]),
        nuisance=rough.fit.nuisance,
        jacobians=jacobians,
        iterations=steps,
        tolerance=tolerance,
    )
    return None if found is None else _scored(problem, again, found)


def _scored(problem: Problem, made: SplineLaw, found: Fit) -> LawFit:
    count = made.spline.count
    inner = profiled(LinearisedFit.of(problem, _without_false_information(made, found)), count)
    whole = np.eye(count) + inner.G
    occam = float(np.linalg.slogdet(whole)[1])
    end = 2 + len(found.parameters)
    spread, own = np.asarray(np.linalg.inv(whole)), slice(end - count, end)
    missed = dispersion(found.residuals, [each[:, own] for each in found.jacobians], spread)
    quadratic = inner.scaled(made.spline.inverse).over(missed)
    coefficients = made.coefficients(found.vector.scaled_values[-count:])
    return LawFit(
        made,
        found,
        score(problem, found) + occam,
        occam,
        quadratic=quadratic,
        coefficients=coefficients,
        covariance=covariance_about(made.spline, quadratic, typical(problem, made.law), coefficients),
    )


def _without_false_information(made: SplineLaw, found: Fit) -> Fit:
    """The fit with a constant factor exactly what friction or rigidity is: errors of their derivatives, which
    are finite differences, would tell one from the other."""
    if not made.law.scales:
        return found
    ones = made.spline.inverse @ np.ones(made.spline.count)
    place, end = (1 if made.law.place == "rigidity" else 0), 2 + len(found.parameters)
    jacobians = []
    for each in found.jacobians:
        same = each.copy()
        same[:, place] = each[:, end - made.spline.count : end] @ ones
        jacobians.append(same)
    return dataclasses.replace(found, jacobians=tuple(jacobians))


def from_formula(given: Problem, spline: LawFit, formula: LawFit) -> LawFit | None:
    """A law's spline fitted to the end from where its formula is."""
    made, stated = spline.made, formula.made
    assert isinstance(made, SplineLaw)
    assert isinstance(stated, FormulaLaw)
    family, vector = made.spline, formula.fit.vector
    others = [each.effect != stated.name for each in formula.fit.parameters]
    at = np.linspace(family.low, family.high, POINTS)
    coefficients = np.asarray(
        np.linalg.pinv(family.basis(at)) @ made.unlinked(stated.formula_at(formula.fit).at(at))
    )
    size = max(float(np.abs(coefficients).max()), LEAST_SHARE * typical(given, made.law))
    again = dataclasses.replace(
        made, spline=dataclasses.replace(family, amplitude=size, roughness=FIRST_ROUGHNESS)
    )
    problem = given.with_effects(again.effect())
    z = np.r_[vector.scaled_values[others], again.scaled_values(coefficients)]
    found = fit(
        problem,
        spline.fit.effects,
        dataclasses.replace(vector, scaled_values=z),
        nuisance=formula.fit.nuisance,
        iterations=FURTHER_STEPS,
        tolerance=ROUGH,
    )
    if found is None:
        return None
    rough = _scored(problem, again, found)
    return further_fit(given, rough, True) or rough


def _starts(problem: Problem, parent: Fit, screened: Screened) -> list[list[ParameterVector]]:
    """Lists of vectors, best first, from each of which a first fit is made.

    Shares of the linearised curve, from where the parent is; where that is far off, also from the stated
    constants, and curves that are there in one section alone, from either.
    """
    made = screened.made
    parameters = problem.parameters((*parent.effects, made.name))
    begin = made.scaled_values(beginning(problem, made))
    state = Objective(problem, parameters, np.r_[parent.vector.scaled_values, begin])
    further = made.scaled_values(screened.coefficients) - begin

    def rated(vectors: Sequence[ParameterVector], curves: Sequence[Array]) -> list[ParameterVector]:
        found: list[tuple[float, int, ParameterVector]] = []
        for vector, z in itertools.product(vectors, curves):
            start = dataclasses.replace(vector, scaled_values=np.r_[vector.scaled_values, z])
            x = state.packed(start, parent.nuisance)
            rows = state.residuals(x)
            if rows is not None:
                found.append((sum_of_squares(rows) + state.prior(x), len(found), start))
        return [start for _, _, start in sorted(found, key=lambda r: r[:2])]

    vectors, sections = [parent.vector], list[list[Array]]()
    if parent.chi2 > FAR * problem.size:
        stated = start_vector(problem, parent.vector.log_friction)
        vectors.append(dataclasses.replace(stated, scaled_values=parent.vector.scaled_values))
        sections = _in_one_section(problem, made)
    lists = [rated([vector], [begin + share * further for share in SHARES]) for vector in vectors]
    lists += [rated(vectors, curves) for curves in sections]
    return [each for each in lists if each]


def _in_one_section(problem: Problem, made: SplineLaw) -> list[list[Array]]:
    """Scaled values of a law along the tissue that is there in one section alone, of several sizes, for each
    section: a linearised curve does not find its way from one section into another."""
    law, spline = made.law, made.spline
    if law.variable != "x" or law.place == "rigidity":
        return []
    centres = spline.low + spline.spacing * (np.arange(spline.count) - 1.0)
    found = []
    for section_m in problem.base.layout.tissue_sections_m:
        start, end = (each / UNIT[law.variable_unit][2] for each in section_m)
        inside = (centres > start - spline.spacing) & (centres < end + spline.spacing)
        sizes = [size for size in SECTION_SIZES if size > 0.0 or law.place != "stiffness"]
        curves = [np.where(inside, size * typical(problem, law), 0.0) for size in sizes]
        found.append([made.scaled_values(curve) for curve in curves])
    return found


def fit_formula(
    given: Problem, parent: Fit, starts: tuple[ParameterVector, ...], made: FormulaLaw
) -> LawFit | None:
    """A formula fitted in the place of a spline, from vectors of all but its own parameters, until one
    reaches the noise."""
    problem = given.with_effects(made.effect())
    names = (*parent.effects, made.name)
    own = problem.parameters([made.name])
    at = np.array([a.scaled_value(a.info.typical) for a in own])
    best: Fit | None = None
    for start in starts:
        vector = dataclasses.replace(start, scaled_values=np.r_[start.scaled_values, at])
        found = fit(problem, names, vector, nuisance=parent.nuisance)
        if found is not None and (best is None or found.objective < best.objective):
            best = found
        if best is not None and excess(problem, best.objective) == 0.0:
            break
    if best is None:
        return None
    unseen = max(0, len(own) - (best.rank - parent.rank))
    price = penalty(problem) * unseen
    return LawFit(made, best, score(problem, best) + price, price)


def held_out(given: Problem, found: LawFit) -> LawFit:
    """The law with commands left out."""
    problem = given.with_effects(found.made.effect())
    return dataclasses.replace(found, validation=cross_validate(problem, found.fit))


def from_task(found: list[Any]) -> list[Any]:
    """Without what could not be solved."""
    return [each for each in found if each is not None]
