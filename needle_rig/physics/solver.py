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
from needle_rig.physics.rod import Indices, Rod
from needle_rig.physics.solution import Path, RodState, Sampled, Solution

if TYPE_CHECKING:
    from needle_rig.physics.kernel.layout import Drive, Laws, Output

DEFAULT_TOLERANCE_RAD = 6e-4
LONGEST_STEP_S = 60.0
SHORTEST_STEP_S = 1e-6
SHORTEST_SNAP_S = 1e-4
LEAST_RESOLVED_SLIP_RAD = math.radians(0.1)
"""Over shorter slips a static excess breaks down at once: the error of the angles alone sets the steps."""


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
    path = Path.of(time_s, base_angle_rad, tip_torque_nm)
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
    paths = [Path.of(*path) for path in inputs]
    for rod in rods:
        _ = rod.coefficients
    jobs = [(rods[i % len(rods)], paths[i % len(paths)]) for i in range(count)]

    def one(job: tuple[Rod, Path]) -> Solution:
        rod, path = job
        most_solves = most_solves_per_sample * path.time_s.size
        return _run(rod, path, None, False, tolerance_rad, LONGEST_STEP_S, most_solves)

    workers = min(threads or os.cpu_count() or 1, count)
    if workers == 1:
        return [one(job) for job in jobs]
    with ThreadPoolExecutor(workers) as pool:
        chunk = max(1, count // (8 * workers))
        chunks = [jobs[i : i + chunk] for i in range(0, count, chunk)]
        return [s for part in pool.map(lambda c: [one(job) for job in c], chunks) for s in part]


def solve_series(
    rod: Rod,
    paths: Sequence[Path],
    friction_factors: Array,
    *,
    tolerance_rad: float = DEFAULT_TOLERANCE_RAD,
    most_solves_per_sample: float = math.inf,
    near: Sequence[tuple[Rod, Array]] = (),
) -> list[list[Sampled]]:
    """Solve trials that one rod serves, each from rest, its slip limits times a factor (trials,).

    All are followed by one call of the compiled solver. Same results and errors as `solve`, a row of trials.
    A further row for each rod of `near`, with its factors: what it would do to first order about `rod`. Each
    must be `in_reach` of the rod.
    """
    rows: list[dict[int, Sampled]] = [{} for _ in range(1 + len(near))]
    for loaded in (False, True):  # a torque on the tip changes what the solver has to follow
        which = [k for k, path in enumerate(paths) if (path.tip_nm.size > 0) is loaded]
        if which:
            followed = _follow(
                rod,
                [paths[k] for k in which],
                friction_factors[which],
                tolerance_rad=tolerance_rad,
                most_solves_per_sample=most_solves_per_sample,
                near=[(other, factors[which]) for other, factors in near],
            )
            for place, k in enumerate(which):
                for row, sampled in zip(rows, followed.of(place), strict=True):
                    row[k] = sampled
    return [[row[k] for k in range(len(paths))] for row in rows]


def in_reach(rod: Rod, other: Rod) -> bool:
    """Whether the solver's tangent reaches from one rod to another.

    Both depend on no rate, and differ in springs, slip limits and compliances alone.
    """
    from needle_rig.physics.kernel import layout

    one, two = rod.coefficients, other.coefficients
    return (
        one.shape == two.shape
        and not (rod.laws or other.laws or any(rod.depends_on_rate) or any(other.depends_on_rate))
        and not (one[[layout.PER_TORQUE, layout.PLAY]].any() or two[[layout.PER_TORQUE, layout.PLAY]].any())
        and bool(np.array_equal(_free(rod), _free(other)))
        and bool(np.array_equal(rod.sensors, other.sensors))
    )


@dataclass(frozen=True, eq=False)
class _Followed:
    """What the solver left of trials one behind another: N samples in all."""

    first_sample: Indices
    output: Output
    state: Array
    """(6, nodes) at the last sample of the last trial."""
    counts: Indices
    near: Output | None = None
    """What each neighbour would do, its torques (N, D) and sensors (N, sensors, D)."""

    def of(self, trial: int) -> list[Sampled]:
        """One trial, and what each neighbour would do in it, as views."""
        from needle_rig.physics.kernel.layout import SOLVES

        rows = slice(self.first_sample[trial], self.first_sample[trial + 1])
        solves = int(self.counts[trial, SOLVES])
        found = [Sampled(self.output.torque_nm[rows], self.output.sensor_rad[rows], solves)]
        if self.near is not None:
            torque_nm, sensor_rad = self.near.torque_nm, self.near.sensor_rad
            for d in range(torque_nm.shape[1]):
                found.append(Sampled(torque_nm[rows, d], sensor_rad[rows, :, d], solves))
        return found


def _run(
    rod: Rod,
    path: Path,
    state: RodState | None,
    shaft: bool,
    tolerance_rad: float,
    longest_step_s: float,
    most_solves: float,
) -> Solution:
    from needle_rig.physics.kernel import layout

    followed = _follow(
        rod,
        [path],
        np.ones(1),
        state=state,
        shaft=shaft,
        tolerance_rad=tolerance_rad,
        longest_step_s=longest_step_s,
        most_solves_per_sample=most_solves / path.time_s.size,
    )
    output, counts = followed.output, followed.counts[0]
    return Solution(
        time_s=path.time_s,
        torque_nm=output.torque_nm,
        sensor_rad=output.sensor_rad,
        tip_rad=output.tip_rad,
        shaft_rad=output.shaft_rad if shaft else None,
        state=RodState(*followed.state),
        steps=int(counts[layout.STEPS]),
        solves=int(counts[layout.SOLVES]),
    )


def _follow(
    rod: Rod,
    paths: Sequence[Path],
    friction_factors: Array,
    *,
    state: RodState | None = None,
    shaft: bool = False,
    tolerance_rad: float,
    longest_step_s: float = LONGEST_STEP_S,
    most_solves_per_sample: float,
    near: Sequence[tuple[Rod, Array]] = (),
) -> _Followed:
    """Follow trials of one rod, with or without a torque on the tip all of them, each from `state`."""
    # numba takes longer to import than most trials to solve
    from needle_rig.physics.kernel import layout
    from needle_rig.physics.kernel.run import Series, run
    from needle_rig.physics.kernel.tangent import Neighbours

    coefficients = rod.coefficients
    loads = bool(paths[0].tip_nm.size)
    if loads and not np.isfinite(coefficients[:2, -1]).all():
        raise BadInput("a torque on a tip that is clamped moves nothing; leave one of the two out")
    nodes = coefficients.shape[1]
    if not (np.isfinite(tolerance_rad) and tolerance_rad > 0 and longest_step_s > 0):
        raise BadInput(f"tolerance {tolerance_rad} rad and longest step {longest_step_s} s must be above 0")
    packed = _relaxed_rows(rod, 0.0) if state is None else _packed_state(rod, state)
    packed[layout.STATUS, 0] = layout.STUCK
    mount = rod.mount_compliance_rad_per_nm
    if mount:
        _turn(packed, -mount * _base_torque_nm(rod, packed))
    if len(paths) == 1:
        drive = layout.Drive(paths[0].time_s, paths[0].base_rad, paths[0].tip_nm)
    else:
        drive = layout.Drive(
            np.concatenate([p.time_s for p in paths]),
            np.concatenate([p.base_rad for p in paths]),
            np.concatenate([p.tip_nm for p in paths]),
        )
    first_sample = np.zeros(len(paths) + 1, dtype=np.int64)
    np.cumsum([p.time_s.size for p in paths], out=first_sample[1:])
    laws, keep = _packed_laws(rod, drive)
    creeps, viscous, memory = rod.depends_on_rate
    play = bool(coefficients[layout.PLAY].any())
    loaded = bool(coefficients[layout.PER_TORQUE].any())
    by_rate = creeps or viscous or memory or not all(law.steady for law in rod.laws)
    dry = by_rate and _some_node_is_dry(coefficients)
    has = layout.Features(creeps, viscous, memory, loaded, len(rod.laws) > 0 or loads or play, play, dry)
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
        most_solves_per_sample=most_solves_per_sample,
        torque_scale=rod.torque_scale,
    )
    sensors = np.ascontiguousarray(rod.sensors, dtype=np.int64)
    samples = int(first_sample[-1])
    output = layout.Output(
        torque_nm=np.empty(samples),
        sensor_rad=np.empty((samples, len(sensors))),
        tip_rad=np.empty(samples),
        shaft_rad=np.empty((samples if shaft else 0, nodes)),
    )
    states = np.empty((layout.SLOTS, *packed.shape))
    counts = np.zeros((len(paths), layout.COUNTS), dtype=np.int64)
    neighbours = Neighbours(
        rods=_near_rods([other for other, _ in near], nodes),
        friction_factor=np.column_stack([f for _, f in near]) if near else np.empty((0, 0)),
        torque_change_nm=np.empty((samples if near else 0, len(near))),
        sensor_change_rad=np.empty((samples if near else 0, len(sensors), len(near))),
    )
    run(
        np.ascontiguousarray(rod.stiffness_nm_per_rad, dtype=np.float64),
        coefficients,
        settings,
        has,
        by_rate,
        laws,
        sensors,
        Series(first_sample, np.ascontiguousarray(friction_factors, dtype=np.float64)),
        packed,
        states,
        output,
        neighbours,
        counts,
    )
    del keep
    packed = states[0].copy()
    _check_followed(rod, drive.time_s, first_sample, counts, output, packed, most_solves_per_sample)
    would = None
    if near:
        torque_nm = output.torque_nm[:, None] + neighbours.torque_change_nm
        mounts = np.array([other.mount_compliance_rad_per_nm for other, _ in near])
        sensor_rad = output.sensor_rad[:, :, None] + neighbours.sensor_change_rad
        would = output._replace(torque_nm=torque_nm, sensor_rad=sensor_rad + (mounts * torque_nm)[:, None, :])
    if mount:
        turned_rad = mount * output.torque_nm
        output.tip_rad[:] += turned_rad
        for angles_rad in (output.sensor_rad, output.shaft_rad):
            angles_rad += turned_rad[: len(angles_rad), np.newaxis]
        _turn(packed, turned_rad[-1])
    return _Followed(first_sample, output, packed, counts, would)


def _near_rods(rods: Sequence[Rod], nodes: int) -> Array:
    """Springs, slip limits in both directions and compliances of rods (4, nodes, rods)."""
    from needle_rig.physics.kernel import layout

    found = np.zeros((4, nodes, len(rods)))
    for d, rod in enumerate(rods):
        coefficients = rod.coefficients
        found[0, :-1, d] = rod.stiffness_nm_per_rad
        found[1:, :, d] = coefficients[[layout.PLUS, layout.MINUS, layout.COMPLIANCE]]
        found[3, 0, d] = rod.base_compliance_rad_per_nm + rod.mount_compliance_rad_per_nm
    return found


def _check_followed(
    rod: Rod,
    time_s: Array,
    first_sample: Indices,
    counts: Indices,
    output: Output,
    packed: Array,
    most_solves_per_sample: float,
) -> None:
    """Raises SolverError where a trial was not followed to its end."""
    from needle_rig.physics.kernel import layout

    ended = counts[:, layout.ENDED]
    if ended.any():
        trial = int(np.argmax(ended != layout.DONE))
        begin, end = first_sample[trial : trial + 2]
        sample = int(begin + counts[trial, layout.FAILED_SAMPLE])
        if ended[trial] == layout.TOO_MANY_SOLVES:
            most_solves = most_solves_per_sample * (end - begin)
            raise SolverError(
                f"more than {most_solves:.0f} solves after {time_s[sample]:g} s: the needle snaps too often"
            )
        node = int(counts[trial, layout.FAILED_NODE])
        raise SolverError(
            f"no balance of torques found after {time_s[sample]:g} s at node {node}"
            f" ({rod.position_m[node] * 1e3:g} mm from the base); check the coefficients there"
        )
    finite = np.isfinite(packed).all(axis=0)
    if not (np.isfinite(output.torque_nm).all() and finite.all()):
        sample = int(np.argmin(np.isfinite(output.torque_nm)))
        node = int(np.argmin(finite))
        raise SolverError(
            f"angles stopped being finite at {time_s[sample]:g} s near node {node}"
            f" ({rod.position_m[node] * 1e3:g} mm from the base); check the torque laws there"
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
