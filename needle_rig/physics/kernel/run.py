"""The one function that Python calls."""

from __future__ import annotations

from numba import njit, types

from needle_rig.physics.kernel._cache import keep_by_package
from needle_rig.physics.kernel._compile import FLOATS
from needle_rig.physics.kernel.extrapolated import follow_extrapolated
from needle_rig.physics.kernel.laws import borrowed
from needle_rig.physics.kernel.layout import (
    ALGORITHMIC,
    COMPLIANCE,
    LIMIT_MINUS,
    LIMIT_PLUS,
    MINUS,
    NO_SOLUTION,
    PLUS,
    SPRING,
    Drive,
    Features,
    Laws,
    Output,
    Settings,
)
from needle_rig.physics.kernel.quasi_static import follow_quasi_static, reach_first_sample
from needle_rig.physics.kernel.sdirk import follow_sdirk

_record = types.BaseTuple.from_types
_ROW, _ROWS, _BLOCK, _INDICES = (
    types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1], types.int64[::1]
)  # fmt: skip
_SIGNATURE = types.int64(
    _ROW,
    _ROWS,
    _record((types.float64,) * len(Settings._fields), Settings),
    _record((types.boolean,) * len(Features._fields), Features),
    types.boolean,
    _record((_INDICES, _INDICES, _ROWS), Laws),
    _record((_ROW, _ROW), Drive),
    _INDICES,
    _INDICES,
    _BLOCK,
    _ROWS,
    _record((_ROW, _ROWS, _ROW, _ROWS), Output),
    _INDICES,
)


keep_by_package()


@njit(_SIGNATURE, cache=True, nogil=True, fastmath=FLOATS, error_model="numpy", no_cfunc_wrapper=True)
def run(stiffness, rod, settings, has, by_rate, laws, drive, sensors, shown, states, work, output, counts):
    """Follow the base path `drive` from the state that stands in every slot of `states`.

    `stiffness` (nodes − 1,) in N·m/rad, `rod` (9, nodes), `states` (SLOTS, 6, nodes), `work` zeros of
    (WORK_ROWS, nodes), `counts` zeros of (6,); `sensors` and `shown` are nodes: those stored and those at which
    samples inside a step must be right; `by_rate`: the rod depends on rates. DONE with the last state in slot 0,
    or NO_SOLUTION or TOO_MANY_SOLVES.
    """
    work, states, rod = borrowed(work), borrowed(states), borrowed(rod)
    output = Output(
        borrowed(output.torque_nm), borrowed(output.sensor_rad), borrowed(output.tip_rad), borrowed(output.shaft_rad)
    )
    n = states.shape[2]
    for i in range(n):
        work[SPRING, i] = stiffness[i] if i < n - 1 else 0.0
        # the base is a stuck node that holds the drive
        work[ALGORITHMIC, i] = rod[COMPLIANCE, i] if i > 0 else settings.base_compliance_rad_per_nm
        work[LIMIT_PLUS, i] = rod[PLUS, i]
        work[LIMIT_MINUS, i] = rod[MINUS, i]
    if not reach_first_sample(rod, settings, has, laws, drive, sensors, states, work, output, counts):
        return NO_SOLUTION
    if not by_rate:
        return follow_quasi_static(rod, settings, has, laws, drive, sensors, states, work, output, counts)
    if has.memory:
        return follow_extrapolated(rod, settings, has, laws, drive, sensors, states, work, output, counts)
    return follow_sdirk(rod, settings, has, laws, drive, sensors, shown, states, work, output, counts)
