"""How strong an effect must be before a dataset shows it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.baseline import Prepared
from needle_rig.workbench.estimation.map_fit import Fit, fit
from needle_rig.workbench.estimation.parameters import Coordinate
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.selection.screening import forms

EXPECTED_GAIN = 16.0
"""Fall of the objective (4σ) at which an effect is found in most datasets."""
STRONGEST = 30.0
WEAKEST = 1e-4


def at_strength(axes: Sequence[Coordinate], strength: float, turn: float = 1.0) -> Array:
    """Positions (k,) of one effect's coordinates at `strength` typical sizes; forms stay typical.

    What may have either sign takes that of `turn`, items of a field alternate; bounds cut.
    """
    positions = forms(axes)[0].copy()
    for k, axis in enumerate(axes):
        if axis.info.shapes:
            continue
        low, high = axis.bounds
        odd = axis.item is not None and axis.item % 2 == 1
        sign = (-turn if odd else turn) if low < 0 < high else 1.0 if high > 0 else -1.0
        positions[k] = min(max(sign * strength, low), high)
    return positions


def smallest_strength(axes: Sequence[Coordinate]) -> float:
    """Strength, in typical sizes, below which an effect does not matter."""
    return max(a.smallest for a in axes if not a.info.shapes)


def detection_limit(prepared: Prepared, effect: str, turn: float = 1.0) -> float:
    """Strength, in typical sizes, at which `effect` would lower the objective by 16 on average.

    From readings without noise of the model with the effect: what the present model, all its parameters
    fitted again, cannot take up. Infinite where not even thirty typical sizes show.
    """
    problem, parent = prepared.problem, prepared.present
    axes = problem.axes([effect])
    idle = _missed(problem, parent, axes, np.zeros(len(axes)))

    def above(log_strength: float) -> float:
        missed = _missed(problem, parent, axes, at_strength(axes, math.exp(log_strength), turn))
        return math.log(max(missed - idle, 1e-6) / EXPECTED_GAIN)

    low, high = math.log(smallest_strength(axes)), math.log(smallest_strength(axes))
    while above(high) < 0:
        low, high = high, high + math.log(2.0)
        if high > math.log(STRONGEST):
            return math.inf
    while above(low) > 0:
        low, high = low - math.log(2.0), low
        if low < math.log(WEAKEST):
            return WEAKEST
    return math.exp(float(brentq(above, low, high, xtol=0.05)))


def _missed(problem: Problem, parent: Fit, axes: Sequence[Coordinate], positions: Array) -> float:
    """Objective of the present model, fitted to what it would read without noise with an effect in it.

    0 where the model cannot be solved.
    """
    point = dataclasses.replace(parent.point, positions=np.r_[parent.point.positions, positions])
    every = list(range(len(problem.trials)))
    try:
        models = [problem.model((*parent.axes, *axes), point, t) for t in every]
        readings = problem.readings(models, every)
    except (SolverError, BadInput):
        return 0.0
    trials = tuple(dataclasses.replace(b, mean=r) for b, r in zip(problem.trials, readings, strict=True))
    found = fit(dataclasses.replace(problem, trials=trials), parent.effects, parent.point)
    return found.objective if found is not None else 0.0
