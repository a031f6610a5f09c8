"""The one function that Python calls, and what it compiles to."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from needle_rig.physics.kernel._cache import keep_by_package, kept
from needle_rig.physics.kernel._compile import FLOATS, OPTIONS, compiled, copy
from needle_rig.physics.kernel.extrapolated import follow_extrapolated
from needle_rig.physics.kernel.laws import borrowed
from needle_rig.physics.kernel.layout import (
    ALGORITHMIC,
    COMPLIANCE,
    DONE,
    ENDED,
    KINETIC_MINUS,
    KINETIC_PLUS,
    LIMIT_MINUS,
    LIMIT_PLUS,
    MINUS,
    NO_SOLUTION,
    PLUS,
    SLOTS,
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
from needle_rig.physics.kernel.tangent import Neighbours, Tangents, begin_tangents

_ROW, _ROWS, _BLOCK, _INDICES = (
    types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1], types.int64[::1]
)  # fmt: skip
_FLAG = types.boolean

keep_by_package()


class Series(NamedTuple):
    """Trials that one rod serves: where each begins in the drive's samples, with the end of the last
    (trials + 1,), and the factor on its slip limits (trials,)."""

    first_sample: Any
    friction_factor: Any


def run(
    stiffness: Any,
    rod: Any,
    settings: Settings,
    has: Features,
    by_rate: bool,
    laws: Laws,
    sensors: Any,
    series: Series,
    start: Any,
    states: Any,
    output: Output,
    neighbours: Neighbours,
    counts: Any,
) -> None:
    """Follow the base paths of the trials of `series`, which stand in `laws.drive` one behind another.

    `stiffness` (nodes − 1,) in N·m/rad, `rod` (12, nodes), `start` (6, nodes) the state in which each trial
    begins, `states` (SLOTS, 6, nodes), `counts` zeros of (trials, COUNTS); `sensors` are nodes, and `by_rate`
    says whether the rod depends on rates. ENDED of a trial's counts is DONE, or NO_SOLUTION or
    TOO_MANY_SOLVES, after which no further trial is followed. The last state is in slot 0 of `states`.
    Changes to neighbours are written for a rod that depends on no rate.
    """
    # numba takes 10 µs to recognise the records, so they are taken apart here and put together again there
    _run(
        stiffness, rod, np.array(settings), *has, by_rate, *laws[:3], *laws.drive, sensors, *series, start,
        states, np.empty((WORK_ROWS, rod.shape[1])), np.empty_like(rod), *output, *neighbours,
        np.empty_like(neighbours.rods), np.empty((3, *neighbours.rods.shape[1:])),
        np.empty(rod.shape[1] if neighbours.rods.size else 0), counts,
    )  # fmt: skip


@compiled
def follow(rod, settings, has, by_rate, laws, sensors, states, work, output, tangents, counts):
    """Follow one trial from the state in every slot. Returns how it ended."""
    drive = laws.drive
    if not reach_first_sample(
        rod, settings, has, laws, drive, sensors, states, work, output, tangents, counts
    ):
        return NO_SOLUTION
    if not by_rate:
        return follow_quasi_static(
            rod, settings, has, laws, drive, sensors, states, work, output, tangents, counts
        )
    if has.memory:
        return follow_extrapolated(rod, settings, has, laws, drive, sensors, states, work, output, counts)
    return follow_sdirk(rod, settings, has, laws, drive, sensors, states, work, output, counts)


@kept(
    types.void(
        _ROW, _ROWS, _ROW, *(_FLAG,) * 8, _INDICES, _INDICES, _ROWS, _ROW, _ROW, _ROW, _INDICES, _INDICES,
        _ROW, _ROWS, _BLOCK, _ROWS, _ROWS, _ROW, _ROWS, _ROW, _ROWS, _BLOCK, _ROWS, _ROWS, _BLOCK, _BLOCK,
        _BLOCK, _ROW, types.int64[:, ::1],
    ),
    fastmath=FLOATS,
    **OPTIONS,
)  # fmt: skip
def _run(
    stiffness, coefficients, scalars, creep, viscous, memory, loaded, with_laws, play, dry, by_rate,
    addresses, parameters, weights_m, time_s, base_rad, tip_nm, sensors, first_sample, friction_factor,
    start, states, work, rod, torque_nm, sensor_rad, tip_rad, shaft_rad, near_rods, near_factors,
    torque_change_nm, sensor_change_rad, changes, of_state, ratio, counts,
):  # fmt: skip
    has = Features(creep, viscous, memory, loaded, with_laws, play, dry)
    coefficients, start, rod = borrowed(coefficients), borrowed(start), borrowed(rod)
    work, states, counts = borrowed(work), borrowed(states), borrowed(counts)
    time_s, base_rad, tip_nm = borrowed(time_s), borrowed(base_rad), borrowed(tip_nm)
    torque_nm, sensor_rad = borrowed(torque_nm), borrowed(sensor_rad)
    tip_rad, shaft_rad = borrowed(tip_rad), borrowed(shaft_rad)
    near_rods, near_factors = borrowed(near_rods), borrowed(near_factors)
    torque_change_nm, sensor_change_rad = borrowed(torque_change_nm), borrowed(sensor_change_rad)
    changes, of_state, ratio = borrowed(changes), borrowed(of_state), borrowed(ratio)
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
    n = states.shape[2]
    loads, shafts, near = tip_nm.size > 0, shaft_rad.shape[0] > 0, ratio.size > 0
    for t in range(friction_factor.size):
        first, end = first_sample[t], first_sample[t + 1]
        drive = Drive(
            time_s[first:end], base_rad[first:end], tip_nm[first if loads else 0 : end if loads else 0]
        )
        laws = Laws(addresses, parameters, weights_m, drive)
        output = Output(
            torque_nm[first:end],
            sensor_rad[first:end],
            tip_rad[first:end],
            shaft_rad[first if shafts else 0 : end if shafts else 0],
        )
        for r in range(rod.shape[0]):
            copy(coefficients[r], rod[r])
        for i in range(n):
            rod[PLUS, i] *= friction_factor[t]
            rod[MINUS, i] *= friction_factor[t]
        for slot in range(SLOTS):
            for r in range(states.shape[1]):
                copy(start[r], states[slot, r])
        for r in range(WORK_ROWS):
            for i in range(n):
                work[r, i] = 0.0
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
        tangents = Tangents(
            changes,
            of_state,
            ratio,
            torque_change_nm[first if near else 0 : end if near else 0],
            sensor_change_rad[first if near else 0 : end if near else 0],
        )
        if near:
            begin_tangents(
                tangents, near_rods, near_factors[t], friction_factor[t], coefficients[PLUS],
                coefficients[MINUS], work,
            )  # fmt: skip
        ended = follow(rod, settings, has, by_rate, laws, sensors, states, work, output, tangents, counts[t])
        counts[t, ENDED] = ended
        if ended != DONE:
            break
