"""Equal slip limits: along them an effect that shapes friction trades with the friction of the trials."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.parameters import FreeParameter
from needle_rig.workbench.estimation.problem import ParameterVector, Problem

Point = tuple[Sequence[FreeParameter], ParameterVector]


def at_same_slip_limits(problem: Problem, before: Point, after: Point) -> ParameterVector:
    """The vector of `after`, with random effects that keep the slip limits of each trial as `before`."""
    vector = after[1]
    change = log_slip_limits_change(problem, before, after)
    return dataclasses.replace(vector, trial_friction=vector.trial_friction - change)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def log_slip_limits_change(problem: Problem, before: Point, after: Point) -> Array:
    """Logarithm of each trial's slip limits (T,) over those `before`; 0 where no effect shapes friction.

    It is 0, too, where a rod cannot be built, or has no friction.
    """
    if not any(problem.library[parameter.effect].has("shape") for parameter in after[0]):
        return np.zeros(len(problem.trials))
    try:
        old_nm, new_nm = _slip_limits(problem, *before), _slip_limits(problem, *after)
    except BadInput:
        return np.zeros(len(problem.trials))
    both = (old_nm > 0) & (new_nm > 0) & np.isfinite(old_nm) & np.isfinite(new_nm)
    return np.log(np.where(both, new_nm, 1.0) / np.where(both, old_nm, 1.0))


def _slip_limits(problem: Problem, parameters: Sequence[FreeParameter], vector: ParameterVector) -> Array:
    """Sum of both slip limits of all nodes that can slip in each trial (T,), N·m."""
    rods = problem.model(parameters, vector).rods([b.trial for b in problem.trials])
    limits_nm = [rod.slip_plus_nm + rod.slip_minus_nm for rod in rods]
    sums_nm = np.array([float(limit_nm[np.isfinite(limit_nm)].sum()) for limit_nm in limits_nm])
    return sums_nm * np.exp(vector.trial_friction)
