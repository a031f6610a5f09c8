"""The one function that Python calls, and what it compiles to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from needle_rig.physics.kernel._cache import keep_by_package, kept
from needle_rig.physics.kernel._compile import FLOATS, OPTIONS
from needle_rig.physics.kernel.extrapolated import follow_extrapolated
from needle_rig.physics.kernel.laws import borrowed
from needle_rig.physics.kernel.layout import (
    ALGORITHMIC,
    COMPLIANCE,
    KINETIC_MINUS,
    KINETIC_PLUS,
    LIMIT_MINUS,
    LIMIT_PLUS,
    MINUS,
    NO_SOLUTION,
    PLUS,
    SPRING,
    STIFFNESS,
    WORK_ROWS,
    Drive,
    Features,
    Laws,
    Output,
    Settings,
)
from needle_rig.physics.kernel.play import start_sides
from needle_rig.physics.kernel.quasi_static import follow_quasi_static, reach_first_sample
from needle_rig.physics.kernel.sdirk import follow_sdirk

_ROW, _ROWS, _BLOCK, _INDICES = (
    types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1], types.int64[::1]
)  # fmt: skip
_FLAG = types.boolean

keep_by_package()


def run(
    stiffness: Any,
    rod: Any,
    settings: Settings,
    has: Features,
    by_rate: bool,
    laws: Laws,
    sensors: Any,
    states: Any,
    output: Output,
    counts: Any,
) -> int:
    """Follow the base path of `laws.drive` from the state that stands in every slot of `states`.

    `stiffness` (nodes − 1,) in N·m/rad, `rod` (11, nodes), `states` (SLOTS, 6, nodes), `counts` zeros of
    (6,); `sensors` are nodes, and `by_rate` says whether the rod depends on rates. Returns DONE, with the
    last state in slot 0, or NO_SOLUTION or TOO_MANY_SOLVES.
    """
    work = np.zeros((WORK_ROWS, rod.shape[1]))
    scalars = np.array(settings)
    # numba takes 10 µs to recognise the records, so they are taken apart here and put together again there
    ended: int = _run(
        stiffness, rod, scalars, *has, by_rate, *laws[:3], *laws.drive, sensors, states, work, *output, counts
    )
    return ended


@kept(
    types.int64(
        _ROW, _ROWS, _ROW, *(_FLAG,) * 8, _INDICES, _INDICES, _ROWS, _ROW, _ROW, _ROW, _INDICES, _BLOCK,
        _ROWS, _ROW, _ROWS, _ROW, _ROWS, _INDICES,
    ),
    fastmath=FLOATS,
    **OPTIONS,
)  # fmt: skip
def _run(
    stiffness, rod, scalars, creep, viscous, memory, loaded, with_laws, play, dry, by_rate, addresses,
    parameters, weights_m, time_s, base_rad, tip_nm, sensors, states, work, torque_nm, sensor_rad, tip_rad,
    shaft_rad, counts,
):  # fmt: skip
    settings = Settings(
        scalars[0],
        scalars[1],
        scalars[2],
        scalars[3],
        scalars[4],
        scalars[5],
        scalars[6],
        scalars[7],
        scalars[8],
        scalars[9],
        scalars[10],
    )
    has = Features(creep, viscous, memory, loaded, with_laws, play, dry)
    drive = Drive(time_s, base_rad, tip_nm)
    laws = Laws(addresses, parameters, weights_m, drive)
    output = Output(borrowed(torque_nm), borrowed(sensor_rad), borrowed(tip_rad), borrowed(shaft_rad))
    work, states, rod = borrowed(work), borrowed(states), borrowed(rod)
    n = states.shape[2]
    for i in range(n):
        work[SPRING, i] = stiffness[i] if i < n - 1 else 0.0
        work[STIFFNESS, i] = work[SPRING, i]
        # the base is a stuck node that holds the drive
        work[ALGORITHMIC, i] = rod[COMPLIANCE, i] if i > 0 else settings.base_compliance_rad_per_nm
        work[KINETIC_PLUS, i] = rod[PLUS, i]
        work[KINETIC_MINUS, i] = rod[MINUS, i]
        work[LIMIT_PLUS, i] = rod[PLUS, i]
        work[LIMIT_MINUS, i] = rod[MINUS, i]
    if has.play:
        start_sides(rod, states, np.intp(0), work)
    if not reach_first_sample(rod, settings, has, laws, drive, sensors, states, work, output, counts):
        return NO_SOLUTION
    if not by_rate:
        return follow_quasi_static(rod, settings, has, laws, drive, sensors, states, work, output, counts)
    if has.memory:
        return follow_extrapolated(rod, settings, has, laws, drive, sensors, states, work, output, counts)
    return follow_sdirk(rod, settings, has, laws, drive, sensors, states, work, output, counts)
