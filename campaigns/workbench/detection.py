"""How strong an effect must be before a dataset shows it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.baseline import Baseline
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.parameters import FreeParameter, at_strength
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.selection.evidence import gain_of

EXPECTED_GAIN = 16.0
"""Fall of the objective (4σ) at which an effect is found in most datasets."""
STRONGEST = 30.0
WEAKEST = 1e-4


def smallest_strength(parameters: Sequence[FreeParameter]) -> float:
    """Strength, in typical sizes, below which an effect does not matter."""
    return max(a.smallest for a in parameters if not a.info.shapes)


def detection_limit(baseline: Baseline, effect: str, turn: float = 1.0) -> float:
    """Strength, in typical sizes, at which `effect` would gain 16 on average.

    From readings without noise of the model with the effect: what the current model, all its parameters
    fitted again, cannot take up. Infinite where not even thirty typical sizes show.
    """
    problem, parent = baseline.problem, baseline.current
    parameters = problem.parameters([effect])
    idle = _missed(problem, parent, parameters, np.zeros(len(parameters)))

    def above(log_strength: float) -> float:
        missed = _missed(problem, parent, parameters, at_strength(parameters, math.exp(log_strength), turn))
        gain = 0.0 if missed is None or idle is None else gain_of(missed, idle)
        return math.log(max(gain, 1e-6) / EXPECTED_GAIN)

    low, high = math.log(smallest_strength(parameters)), math.log(smallest_strength(parameters))
    while above(high) < 0:
        low, high = high, high + math.log(2.0)
        if high > math.log(STRONGEST):
            return math.inf
    while above(low) > 0:
        low, high = low - math.log(2.0), low
        if low < math.log(WEAKEST):
            return WEAKEST
    return math.exp(float(brentq(above, low, high, xtol=0.05)))


def _missed(
    problem: Problem, parent: Fit, parameters: Sequence[FreeParameter], scaled_values: Array
) -> Fit | None:
    """The current model, fitted to what it would read without noise with an effect in it.

    None where the model cannot be solved.
    """
    vector = dataclasses.replace(
        parent.vector, scaled_values=np.r_[parent.vector.scaled_values, scaled_values]
    )
    every = list(range(len(problem.trials)))
    try:
        models = [problem.model((*parent.parameters, *parameters), vector, t) for t in every]
        readings = problem.readings(models, every)
    except (SolverError, BadInput):
        return None
    trials = tuple(dataclasses.replace(b, mean=r) for b, r in zip(problem.trials, readings, strict=True))
    return fit(dataclasses.replace(problem, trials=trials), parent.effects, parent.vector)
