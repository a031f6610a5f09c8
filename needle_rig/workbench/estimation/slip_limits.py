"""Equal slip limits: along them an effect that shapes friction trades with the friction of the trials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.parameters import FreeParameter
from needle_rig.workbench.estimation.problem import ParameterVector, Problem


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def log_slip_limits(problem: Problem, parameters: Sequence[FreeParameter], vector: ParameterVector) -> Array:
    """Logarithm of the sum of both slip limits, N·m, of all nodes that can slip, in each trial (T,).

    NaN where a rod cannot be built, or has no friction.
    """
    try:
        rods = problem.model(parameters, vector).rods([b.trial for b in problem.trials])
    except BadInput:
        return np.full(len(problem.trials), np.nan)
    limits_nm = [rod.slip_plus_nm + rod.slip_minus_nm for rod in rods]
    sums_nm = np.array([float(limit_nm[np.isfinite(limit_nm)].sum()) for limit_nm in limits_nm])
    sums_nm = sums_nm * np.exp(vector.trial_friction)
    return np.log(np.where((sums_nm > 0.0) & np.isfinite(sums_nm), sums_nm, np.nan))
