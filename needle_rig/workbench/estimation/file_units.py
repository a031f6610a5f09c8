"""Shared parameters between the scale of fits and the units of files.

Vectors (p,) hold logarithms of friction (N) and of torsional rigidity (N·m²), then scaled values.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needle_rig.model import SavedModel
from needle_rig.numerics import Array
from needle_rig.physics.needle_model import BASE_PARAMETERS, NMM2_PER_NM2, NeedleModel
from needle_rig.units import per_100mm
from needle_rig.workbench.estimation.gaussian import Gaussian
from needle_rig.workbench.estimation.parameters import FreeParameter, scaled_values_of, shared_names

LEAST_FRICTION_N = 1e-7
"""Whose logarithm stands for no friction: none that a sensor sees."""


def shared_units(parameters: Sequence[FreeParameter]) -> tuple[str, ...]:
    """The unit of each shared parameter in files."""
    return (*(info.unit for info in BASE_PARAMETERS.values()), *(p.info.unit for p in parameters))


def within_bounds(parameters: Sequence[FreeParameter], x: Array) -> Array:
    """x (p,) with scaled values in their bounds."""
    inside = x.copy()
    inside[2:] = [np.clip(v, *p.bounds) for p, v in zip(parameters, x[2:], strict=True)]
    return inside


def in_file_units(parameters: Sequence[FreeParameter], x: Array) -> Array:
    """The vector x (p,) in the units of files; a logarithm beyond the largest number is infinite."""
    effects = [p.value(float(v)) for p, v in zip(parameters, x[2:], strict=True)]
    with np.errstate(over="ignore"):
        friction_n, rigidity_nm2 = np.exp(x[:2])
    return np.asarray(np.r_[per_100mm(friction_n), rigidity_nm2 * NMM2_PER_NM2, effects])


def deviations_in_file_units(parameters: Sequence[FreeParameter], x: Array, deviations: Array) -> Array:
    """Standard deviations (p,) in the units of files; of a parameter at its bound, from the side inside."""
    steps = []
    for parameter, at, size in zip(parameters, x[2:], deviations[2:], strict=True):
        ends = np.clip([at - size, at + size], *parameter.bounds)
        span = abs(parameter.value(float(ends[1])) - parameter.value(float(ends[0])))
        steps.append(span / max(float(np.ptp(ends)), 1e-12) * size)
    values = in_file_units(parameters, x)
    return np.asarray(np.r_[values[:2] * deviations[:2], steps])


def vector_of(parameters: Sequence[FreeParameter], model: NeedleModel) -> Array:
    """The shared parameters (p,) of a model."""
    friction_n = max(model.friction_n, LEAST_FRICTION_N * model.torque_scale)
    base = np.log([friction_n, model.torsional_rigidity_nm2])
    return np.concatenate([base, scaled_values_of(parameters, model.effects)])


def values_by_name(parameters: Sequence[FreeParameter], model: NeedleModel) -> dict[str, float]:
    """The same by name, as a problem fixes them."""
    return dict(zip(shared_names(parameters), vector_of(parameters, model).tolist(), strict=True))


def known_of(parameters: Sequence[FreeParameter], saved: SavedModel, otherwise: Gaussian) -> Gaussian:
    """What a model file knows of the shared parameters; as `otherwise` where it has no uncertainty."""
    names, values = shared_names(parameters), saved.model.values()
    at, mean, widths = vector_of(parameters, saved.model), otherwise.mean.copy(), otherwise.deviations
    for i, name in enumerate(names):
        size = saved.uncertainties.get(name)
        if not size or not np.isfinite(size):
            continue
        value = values[name]
        mean[i] = at[i]
        widths[i] = size / value if name in BASE_PARAMETERS else _scaled(parameters[i - 2], value, size)
    correlation = np.eye(len(names))
    for (one, other), value in saved.correlations.items():
        if one in names and other in names:
            i, k = names.index(one), names.index(other)
            correlation[i, k] = correlation[k, i] = value
    return Gaussian(mean, correlation * np.outer(widths, widths))


def _scaled(parameter: FreeParameter, value: float, size: float) -> float:
    """A standard deviation about `value` on the parameter's scale."""
    reach = np.clip([value - size, value + size], parameter.info.lower, parameter.info.upper)
    ends = [parameter.scaled_value(float(v)) for v in reach]
    return abs(ends[1] - ends[0]) / float(np.ptp(reach)) * size
