"""What adopting takes over from a diagnosis of settled values."""

from __future__ import annotations

import dataclasses

import numpy as np

from needle_rig.model import ChannelErrors
from needle_rig.numerics import Array
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.published.fit import SettledFit, SettledProblem, held_out_error
from needle_rig.workbench.selection.explanation import IN_NOISE_UNITS, Explanation, spread_of_values


def explanation(problem: SettledProblem, root: SettledFit, found: SettledFit) -> Explanation:
    """A fit with everything that it adds to the current model's, `root`. Raises SolverError, BadInput."""
    held_before, held_after = held_out_error(problem, root), held_out_error(problem, found)
    model = problem.model(found.parameters, found.x)
    before, after = by_quantity(problem, root.predicted), by_quantity(problem, found.predicted)
    errors = {
        name: ChannelErrors(training_before=before[name], training_after=after[name], floor=floor)
        for name, floor in scatter_by_quantity(problem).items()
    }
    errors[IN_NOISE_UNITS] = ChannelErrors(
        training_before=float(np.sqrt(root.chi2 / len(problem.values))),
        training_after=float(np.sqrt(found.chi2 / len(problem.values))),
        held_out_before=held_before if np.isfinite(held_before) else None,
        held_out_after=held_after if np.isfinite(held_after) else None,
        floor=1.0,
    )
    stated = np.log(problem.data.needle.torsional_rigidity_nm2)
    x = np.r_[found.x[0], found.x[1] + stated, found.x[2:]]
    return Explanation(
        added=tuple(e for e in found.effects if e not in root.effects),
        model=dataclasses.replace(model, element_length_m=NeedleModel.element_length_m),
        uncertainties=spread_of_values(found.parameters, x, found.covariance),
        values_before=problem.model(root.parameters, root.x).values(),
        errors=errors,
        improves=bool(held_after < held_before),
    )


def by_quantity(problem: SettledProblem, predicted: Array) -> dict[str, float]:
    """Root mean square error of `predicted` (n,) by quantity, in the unit that its name ends in."""
    left = problem.measured - predicted
    return {name: float(np.sqrt(np.mean(left[places] ** 2))) for name, places in _quantities(problem).items()}


def scatter_by_quantity(problem: SettledProblem) -> dict[str, float]:
    """Root mean square standard error by quantity, in the unit that its name ends in."""
    return {
        name: float(np.sqrt(np.mean(problem.errors[places] ** 2)))
        for name, places in _quantities(problem).items()
    }


def _quantities(problem: SettledProblem) -> dict[str, list[int]]:
    """Places of the values of each quantity."""
    places: dict[str, list[int]] = {}
    for place, value in enumerate(problem.values):
        places.setdefault(value.of.quantity, []).append(place)
    return places
