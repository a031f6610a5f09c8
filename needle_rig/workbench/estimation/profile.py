"""Profiles of the posterior along form parameters, for the spread of a fit.

Where a needle snaps from balance to balance, the objective is jagged: its curvature is that between two snaps
and says nothing of the valley in which a form parameter, as a rest time, and a strength make up for each
other. A profile is the objective with one parameter held and all others fitted again (Raue et al.,
Bioinformatics 25 (2009) 1923), here of the posterior.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.map_fit import OBJECTIVE_TOLERANCE, fit
from needle_rig.workbench.estimation.parameters import shared_names
from needle_rig.workbench.estimation.problem import Fit, Problem

FIRST_STEPS = (1e-3, 0.05)
"""Shortest and longest first step of a form parameter from the fit, in scaled values: 0.2 and 12 % where the
scale is a decade; between them it is the error that the curvature tells. Each further step doubles the way,
so that a narrow valley is resolved and a wide one reached."""
REACH = 3.0
"""Farthest from the fit, in scaled values: beyond the prior of a form."""
RISE = 8.0
"""Of the objective at which a profile ends: what lies beyond has less than a fiftieth of the weight."""
TOLERANCE = 0.2
"""Fall of the objective below which a fit with a form parameter held ends: a tenth of the weight."""


@dataclass(frozen=True)
class _Point:
    """A fit with the parameter at `place` of x held."""

    place: int
    fit: Fit

    @property
    def at(self) -> Array:
        """Shared parameters (p,)."""
        return self.fit.vector.shared

    @property
    def covariance(self) -> Array:
        """Of the shared parameters (p, p), given the one that is held."""
        whole = self.fit.covariance
        column = whole[:, self.place]
        explained = np.outer(column, column) / max(float(whole[self.place, self.place]), 1e-30)
        return np.asarray(whole - explained)


def over_profiles(problem: Problem, found: Fit) -> Fit:
    """The lowest fit along the profile of each form parameter, with the covariance of all of them.

    A profile is a mixture of normal distributions, weighted by their posterior probabilities over the
    parameter that is held; the widest counts, parameter by parameter. The fit keeps its covariance where it
    has no form parameter, or where the objective rises at once to all sides.
    """
    forms = [
        2 + k for k, parameter in enumerate(found.parameters) if parameter.info.shapes and not parameter.held
    ]
    profiles = []
    for place in forms:
        points = _profile(problem, found, place)
        lowest = min(points, key=lambda p: p.fit.objective).fit
        if lowest.objective < found.objective - OBJECTIVE_TOLERANCE:
            freed = fit(problem, found.effects, lowest.vector, nuisance=lowest.nuisance)
            if freed is not None and freed.objective < found.objective:
                found = freed
        profiles.append(points)
    covariances = [_mixture(points, found) for points in profiles if _resolved(points)]
    if not covariances:
        return found
    spreads = np.sqrt([np.diag(c) for c in covariances])
    widest = int(spreads[:, forms].prod(axis=1).argmax())
    wider = spreads.max(axis=0) / np.maximum(spreads[widest], 1e-30)
    return dataclasses.replace(found, covariance=covariances[widest] * np.outer(wider, wider))


def _profile(problem: Problem, found: Fit, place: int) -> list[_Point]:
    """The fit and those on both sides of it, until the objective has risen or a bound is reached."""
    k = place - 2
    first = _Point(place, found)
    points, lowest = [first], found.objective
    for side in (-1.0, 1.0):
        last, slope = first, found.covariance[:, place] / max(float(found.covariance[place, place]), 1e-30)
        way = float(np.clip(found.scaled_errors[k], *FIRST_STEPS))
        while way < REACH:
            at = float(np.clip(first.at[place] + side * way, *found.parameters[k].bounds))
            if at == last.at[place]:
                break
            way *= 2.0
            # along the valley; where that leads up a snap, from where the last point lies
            for along in (slope, np.eye(slope.size)[place]):
                held = _held(problem, last, last.at + along * (at - last.at[place]))
                if held is not None and held.fit.objective <= lowest + RISE:
                    break
            if held is None:
                break
            points.append(held)
            slope = (held.at - last.at) / (at - last.at[place])
            last, lowest = held, min(lowest, held.fit.objective)
            if held.fit.objective > lowest + RISE:
                break
    return points


def _held(problem: Problem, near: _Point, start: Array) -> _Point | None:
    """The fit from the shared parameters `start` (p,) and all others of the point `near`."""
    vector = dataclasses.replace(
        near.fit.vector,
        log_friction=float(start[0]),
        log_rigidity=float(start[1]),
        scaled_values=start[2:],
    )
    name = shared_names(near.fit.parameters)[near.place]
    held = fit(
        problem.fixing({name: float(start[near.place])}),
        near.fit.effects,
        vector,
        nuisance=near.fit.nuisance,
        tolerance=TOLERANCE,
    )
    return None if held is None else _Point(near.place, held)


def _resolved(points: list[_Point]) -> bool:
    """Whether a neighbour of the lowest point has weight beside it."""
    objectives = sorted(p.fit.objective for p in points)
    return len(objectives) > 1 and objectives[1] < objectives[0] + RISE


def _mixture(points: list[_Point], centre: Fit) -> Array:
    """Second moment (p, p) of a profile about `centre`; a point stands for the way to its neighbours."""
    place = points[0].place
    points = sorted(points, key=lambda p: p.at[place])
    middle = _Point(place, centre).at
    at = np.array([p.at[place] for p in points])
    width = np.convolve(np.diff(at), (0.5, 0.5))
    lowest = min(p.fit.objective for p in points)
    weights = width * np.exp([0.5 * (lowest - p.fit.objective) for p in points])
    parts = [
        w * (p.covariance + np.outer(p.at - middle, p.at - middle))
        for w, p in zip(weights, points, strict=True)
    ]
    return np.asarray(sum(parts) / weights.sum(), dtype=np.float64)
