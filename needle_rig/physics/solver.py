"""Follows a rod while its base is turned: one trial, or many side by side on threads."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.physics.rod import Rod

if TYPE_CHECKING:
    from needle_rig.physics.kernel.layout import Drive, Laws

DEFAULT_TOLERANCE_RAD = 6e-4
LONGEST_STEP_S = 60.0
SHORTEST_STEP_S = 1e-6
SHORTEST_SNAP_S = 1e-4
LEAST_RESOLVED_SLIP_RAD = math.radians(0.1)
"""Over shorter slips a static excess breaks down at once: the error of the angles alone sets the steps."""


@dataclass(frozen=True, eq=False)
class RodState:
    """Everything a rod remembers; arrays of shape (nodes,)."""

    angle_rad: Array
    anchor_rad: Array
    """Plastic anchor: where the tissue holds the node; of the base node the turned base."""
    creep_rad: Array
    excess_state: Array
    """State variable of the static excess, 0 to 1."""
    age_s: Array
    slip: Array
    """Direction of slip of the last step, −1, 0 or 1; 2 where nothing resists a turn."""


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solved rod did at `time_s` (samples,)."""

    time_s: Array
    torque_nm: Array
    """Torque that the base exerts on the needle, shape (samples,)."""
    sensor_rad: Array
    """Shape (samples, sensors)."""
    tip_rad: Array
    shaft_rad: Array | None
    """Angle of every node, shape (samples, nodes), when asked for."""
    state: RodState
    """At the last sample; give it to `solve` to go on."""
    steps: int
    solves: int


def relaxed(rod: Rod, angle_rad: float = 0.0) -> RodState:
    """The state of a rod at rest without any twist, base and needle at `angle_rad`."""
    return RodState(*_relaxed_rows(rod, angle_rad))


def _relaxed_rows(rod: Rod, angle_rad: float) -> Array:
    """The rows of `RodState` as one array, shape (6, nodes)."""
    rows = np.zeros((6, len(rod.position_m)))
    rows[:2] = angle_rad
    rows[3] = 1.0
    rows[5, _free(rod)] = 2.0
    return rows


def solve(
    rod: Rod,
    time_s: Array,
    base_angle_rad: Array,
    tip_torque_nm: Array | None = None,
    *,
    state: RodState | None = None,
    shaft: bool = False,
    tolerance_rad: float = DEFAULT_TOLERANCE_RAD,
    longest_step_s: float = LONGEST_STEP_S,
    most_solves: float = math.inf,
) -> Solution:
    """Turn the base along the line through (time_s, base_angle_rad), shapes (samples,).

    `tip_torque_nm` (samples,) acts on the tip, positive where it turns the needle counter-clockwise.
    The first sample is the start: `state` (default: relaxed at 0) holds at time_s[0]; a base angle there that
    differs from the state's is reached within one sample, and so is the first torque on the tip.
    `tolerance_rad` bounds the error of one time step where slip or creep depend on rate, of all angles and,
    times 5e-4 N·m/rad and the torque scale, of the base torque; no dry node is ever above its slip limit.
    A rod without viscosity, creep, slip limits with memory and laws other than steady ones depends on no
    rate: one implicit step a sample is exact.

    Raises BadInput before computing anything, and SolverError naming time and node when no solution was
    found, or the time where `most_solves` were spent.
    """
    path = _checked_path(time_s, base_angle_rad, tip_torque_nm)
    return _run(rod, path, state, shaft, tolerance_rad, longest_step_s, most_solves)


def solve_batch(
    rods: Sequence[Rod],
    inputs: Sequence[tuple[Array, Array] | tuple[Array, Array, Array | None]],
    *,
    threads: int | None = None,
    tolerance_rad: float = DEFAULT_TOLERANCE_RAD,
    most_solves_per_sample: float = math.inf,
) -> list[Solution]:
    """Solve independent trials, (time_s, base_angle_rad, tip_torque_nm or none) a rod, on `threads` cores.

    One rod or one input serves for all of the others. Same results and errors as `solve`.
    """
    count = max(len(rods), len(inputs))
    if len(rods) not in (1, count) or len(inputs) not in (1, count):
        raise BadInput(f"{len(rods)} rods and {len(inputs)} inputs: give one of each, or as many of both")
    if not rods or not inputs:
        return []
    paths = [_checked_path(*path) for path in inputs]
    for rod in rods:
        _ = rod.coefficients
    jobs = [(rods[i % len(rods)], paths[i % len(paths)]) for i in range(count)]

    def one(job: tuple[Rod, _Path]) -> Solution:
        rod, path = job
        most_solves = most_solves_per_sample * path[0].size
        return _run(rod, path, None, False, tolerance_rad, LONGEST_STEP_S, most_solves)

    workers = min(threads or os.cpu_count() or 1, count)
    if workers == 1:
        return [one(job) for job in jobs]
    with ThreadPoolExecutor(workers) as pool:
        chunk = max(1, count // (8 * workers))
        chunks = [jobs[i : i + chunk] for i in range(0, count, chunk)]
        return [s for part in pool.map(lambda c: [one(job) for job in c], chunks) for s in part]


_Path = tuple[Array, Array, Array]
"""Times, base angles and torques on the tip; the last is empty where there is none."""


def _checked_path(time_s: Array, base_angle_rad: Array, tip_torque_nm: Array | None = None) -> _Path:
    time = np.ascontiguousarray(time_s, dtype=np.float64)
    base = np.ascontiguousarray(base_angle_rad, dtype=np.float64)
    tip = np.ascontiguousarray(np.empty(0) if tip_torque_nm is None else tip_torque_nm, dtype=np.float64)
    if time.ndim != 1 or time.shape != base.shape:
        raise BadInput(f"times {time.shape} and base angles {base.shape} must be two rows of the same length")
    if tip_torque_nm is not None and tip.shape != time.shape:
        raise BadInput(
            f"times {time.shape} and torques on the tip {tip.shape} must be rows of the same length"
        )
    if time.size == 0:
        raise BadInput("the trajectory is empty; give at least the starting time and base angle")
    for name, values in (("time", time), ("base angle", base), ("tip torque", tip)):
        finite = np.isfinite(values)
        if not finite.all():
            sample = int(np.argmin(finite))
            raise BadInput(f"{name} is {values[sample]} at sample {sample}; it must be a finite number")
    if time.size > 1 and not (np.diff(time) > 0).all():
        sample = int(np.argmin(np.diff(time) > 0)) + 1
        raise BadInput(
            f"time goes from {time[sample - 1]:g} to {time[sample]:g} s at sample {sample};"
            " times must increase from sample to sample"
        )
    return time, base, tip


def _run(
    rod: Rod,
    path: _Path,
    state: RodState | None,
    shaft: bool,
    tolerance_rad: float,
    longest_step_s: float,
    most_solves: float,
) -> Solution:
    # numba takes longer to import than most trials to solve
    from needle_rig.physics.kernel import layout
    from needle_rig.physics.kernel.run import run

    time, base, tip = path
    coefficients = rod.coefficients
    if tip.size and not np.isfinite(coefficients[:2, -1]).all():
        raise BadInput("a torque on a tip that is clamped moves nothing; leave one of the two out")
    nodes = coefficients.shape[1]
    if not (np.isfinite(tolerance_rad) and tolerance_rad > 0 and longest_step_s > 0):
        raise BadInput(f"tolerance {tolerance_rad} rad and longest step {longest_step_s} s must be above 0")
    packed = _relaxed_rows(rod, 0.0) if state is None else _packed_state(rod, state)
    packed[layout.STATUS, 0] = layout.STUCK
    mount = rod.mount_compliance_rad_per_nm
    if mount:
        _turn(packed, -mount * _base_torque_nm(rod, packed))
    laws, keep = _packed_laws(rod, layout.Drive(time, base, tip))
    creeps, viscous, memory = rod.depends_on_rate
    play = bool(coefficients[layout.PLAY].any())
    loaded = bool(coefficients[layout.PER_TORQUE].any())
    by_rate = creeps or viscous or memory or not all(law.steady for law in rod.laws)
    dry = by_rate and _some_node_is_dry(coefficients)
    has = layout.Features(
        creeps, viscous, memory, loaded, len(rod.laws) > 0 or tip.size > 0 or play, play, dry
    )
    settings = layout.Settings(
        # seen from the mount, the base stays behind by the mount's turn as by that of a spring of its own
        base_compliance_rad_per_nm=rod.base_compliance_rad_per_nm + mount,
        stribeck_rate_rad_s=rod.stribeck_rate_rad_s,
        stribeck_exponent=rod.stribeck_exponent,
        weakening_rad=rod.weakening_rad,
        ageing_time_s=rod.ageing_time_s,
        # angles show an error of the slip limits only later, when the limits are reached
        tolerance_rad=tolerance_rad / 6.0 if memory else tolerance_rad,
        longest_step_s=longest_step_s,
        # a snap to a lower limit takes no time: shorter steps do not resolve it better
        shortest_step_s=SHORTEST_SNAP_S if memory else SHORTEST_STEP_S,
        # over a slip of the weakening length the static excess breaks down, while an age only halves
        longest_slip_rad=max(
            rod.weakening_rad / (8.0 if np.any(rod.static_excess) else 4.0), LEAST_RESOLVED_SLIP_RAD
        ),
        most_solves=most_solves,
        torque_scale=rod.torque_scale,
    )
    sensors = np.ascontiguousarray(rod.sensors, dtype=np.int64)
    output = layout.Output(
        torque_nm=np.empty(time.size),
        sensor_rad=np.empty((time.size, len(sensors))),
        tip_rad=np.empty(time.size),
        shaft_rad=np.empty((time.size if shaft else 0, nodes)),
    )
    states = np.repeat(packed[np.newaxis], layout.SLOTS, axis=0)
    counts = np.zeros(6, dtype=np.int64)
    ended = run(
        np.ascontiguousarray(rod.stiffness_nm_per_rad, dtype=np.float64),
        coefficients,
        settings,
        has,
        by_rate,
        laws,
        sensors,
        states,
        output,
        counts,
    )
    del keep
    packed = states[0].copy()
    sample = int(counts[layout.FAILED_SAMPLE])
    if ended == layout.TOO_MANY_SOLVES:
        raise SolverError(
            f"more than {most_solves:.0f} solves after {time[sample]:g} s: the needle snaps too often"
        )
    if ended == layout.NO_SOLUTION:
        node = int(counts[layout.FAILED_NODE])
        raise SolverError(
            f"no balance of torques found after {time[sample]:g} s at node {node}"
            f" ({rod.position_m[node] * 1e3:g} mm from the base); check the coefficients there"
        )
    finite = np.isfinite(packed).all(axis=0)
    if not (np.isfinite(output.torque_nm).all() and finite.all()):
        sample = int(np.argmin(np.isfinite(output.torque_nm)))
        node = int(np.argmin(finite))
        raise SolverError(
            f"angles stopped being finite at {time[sample]:g} s near node {node}"
            f" ({rod.position_m[node] * 1e3:g} mm from the base); check the torque laws there"
        )
    if mount:
        turned_rad = mount * output.torque_nm
        output.tip_rad[:] += turned_rad
        for angles_rad in (output.sensor_rad, output.shaft_rad):
            angles_rad += turned_rad[: len(angles_rad), np.newaxis]
        _turn(packed, turned_rad[-1])
    return Solution(
        time_s=time,
        torque_nm=output.torque_nm,
        sensor_rad=output.sensor_rad,
        tip_rad=output.tip_rad,
        shaft_rad=output.shaft_rad if shaft else None,
        state=RodState(*packed),
        steps=int(counts[layout.STEPS]),
        solves=int(counts[layout.SOLVES]),
    )


def _base_torque_nm(rod: Rod, packed: Array) -> float:
    return float(rod.stiffness_nm_per_rad[0] * (packed[0, 0] - packed[0, 1]))


def _turn(packed: Array, by_rad: float) -> None:
    """Turn the needle and what holds it, but not the base's drive, in place."""
    packed[0] += by_rad
    packed[1, 1:] += by_rad


def _some_node_is_dry(coefficients: Array) -> bool:
    """Whether somewhere friction has no part that grows with the rate."""
    from needle_rig.physics.kernel import layout

    limits = coefficients[[layout.PLUS, layout.MINUS, layout.PER_TORQUE]]
    return bool(((coefficients[layout.VISCOUS] == 0) & (limits > 0).any(axis=0)).any())


def _free(rod: Rod) -> Array:
    """Whether nothing resists a turn of each node."""
    from needle_rig.physics.kernel import layout

    limits = rod.coefficients[[layout.PLUS, layout.MINUS, layout.PER_TORQUE]]
    return np.asarray((limits == 0).all(axis=0))


def _packed_state(rod: Rod, state: RodState) -> Array:
    nodes = len(rod.position_m)
    rows = (state.angle_rad, state.anchor_rad, state.creep_rad, state.excess_state, state.age_s, state.slip)
    packed = np.empty((6, nodes))
    for row, values in enumerate(rows):
        if np.shape(values) != (nodes,):
            raise BadInput(f"the state has {np.shape(values)} values a row; the rod has {nodes} nodes")
        packed[row] = values
    if not np.isfinite(packed).all():
        raise BadInput("the state holds a value that is not a finite number; start from relaxed(rod)")
    # friction may have been added or taken away since the state was made
    packed[5] = np.where(_free(rod), 2.0, np.where(np.abs(packed[5]) == 2.0, 0.0, packed[5]))
    return packed


def _packed_laws(rod: Rod, drive: Drive) -> tuple[Laws, list[Array]]:
    """The torque laws as addresses and weights, and what must stay alive."""
    from needle_rig.physics.kernel.laws import law_address
    from needle_rig.physics.kernel.layout import Laws

    count = len(rod.laws)
    laws = Laws(
        addresses=np.zeros(count, dtype=np.int64),
        parameters=np.zeros(count, dtype=np.int64),
        weights_m=np.zeros((count, len(rod.position_m))),
        drive=drive,
    )
    keep = []
    for row, law in enumerate(rod.laws):
        values = np.ascontiguousarray(np.append(np.asarray(law.parameters, dtype=np.float64), 0.0))
        if not np.isfinite(values).all() or np.shape(law.weight_m) != laws.weights_m.shape[1:]:
            raise BadInput("a torque law needs finite parameters and one weight_m a node")
        laws.addresses[row] = law_address(law.law)
        laws.parameters[row] = values.ctypes.data
        laws.weights_m[row] = law.weight_m
        keep.append(values)
    return laws, keep
