"""Looks for the fewest and shortest rotations that leave the shaft straight at the target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from needle_rig.control.lag import effective_length_m, tissue_length_m
from needle_rig.control.planning.belief import World
from needle_rig.control.strategy import Task
from needle_rig.physics.effect import Trial
from needle_rig.units import rad

Array = npt.NDArray[np.float64]

TORQUE_WEIGHT = 0.2
"""Of the lag that the torque left stands for, beside the worst angle error."""
BASE_WEIGHT = 0.15
"""Of the base's distance from the target."""
ROTATION_WEIGHT = 0.001
"""Of the total rotation: of two plans as good, the shorter."""
FINAL_BOUND_RAD = rad(10.0)
GRID = {2: (41,), 3: (15, 13)}
DESCENTS = 3


@dataclass(frozen=True)
class Aim:
    """What every plan must keep to; the window is what follows each settling."""

    task: Task
    base_rad: float
    overshoot_rad: float
    settle_s: float
    quantile: float
    window_s: float = 0.5

    @property
    def reach(self) -> tuple[float, float]:
        """Lowest and highest base angle allowed: the overshoot around start and target, within the drive."""
        limit = self.task.angle_limit_rad
        low = min(self.task.target_rad - self.overshoot_rad, self.base_rad)
        high = max(self.task.target_rad + self.overshoot_rad, self.base_rad)
        return max(low, -limit), min(high, limit)


@dataclass(frozen=True)
class Ends:
    """What a sequence leaves in each world, shapes (worlds,): angles from the target, torque at the base."""

    worst_rad: Array
    torque_nm: Array


@dataclass(frozen=True)
class Plan:
    """Base angles to go to, and what they should leave."""

    angles_rad: tuple[float, ...]
    cost_rad: float
    ends: Ends


def carry_out(aim: Aim, worlds: Sequence[World], angles_rad: Sequence[float]) -> Ends:
    """What turning the base through `angles_rad` leaves in each world."""
    times, path = [0.0], [aim.base_rad]
    last = len(angles_rad) - 1
    for place, angle in enumerate(angles_rad):
        travel = max(abs(angle - path[-1]) / aim.task.speed_rad_s, 1e-3)
        settle = (aim.task.settle_s if place == last else aim.settle_s) + aim.window_s
        times += [times[-1] + travel, times[-1] + travel + settle]
        path += [angle, angle]
    time_s, base_rad = np.array(times), np.array(path)
    worst, torque = np.empty(len(worlds)), np.empty(len(worlds))
    for k, world in enumerate(worlds):
        if angles_rad:
            solution = world.model.truth(Trial(time_s, base_rad), world.state)
            shaft, torque[k] = solution.state.angle_rad, solution.torque_nm[-1]
        else:
            shaft, torque[k] = world.state.angle_rad, _held_torque(world)
        worst[k] = np.abs(shaft[world.tissue] - aim.task.target_rad).max()
    return Ends(worst, torque)


def cost(aim: Aim, angles_rad: Sequence[float], ends: Ends) -> float:
    """The quantile over the worlds of worst error and torque left, with a little for rotation, radians."""
    task = aim.task
    lag = np.abs(ends.torque_nm) * effective_length_m(task.layout) / task.torsional_rigidity_nm2
    each = ends.worst_rad + TORQUE_WEIGHT * lag
    path = (aim.base_rad, *angles_rad)
    turned = float(np.abs(np.diff(path)).sum())
    off = abs(path[-1] - task.target_rad)
    value = float(np.quantile(each, aim.quantile)) if len(each) > 1 else float(each[0])
    return value + BASE_WEIGHT * off + ROTATION_WEIGHT * turned


def rate(aim: Aim, worlds: Sequence[World], angles_rad: Sequence[float]) -> Plan:
    """The plan `angles_rad` with what it leaves."""
    angles = tuple(float(a) for a in angles_rad)
    ends = carry_out(aim, worlds, angles)
    return Plan(angles, cost(aim, angles, ends), ends)


def best_plan(aim: Aim, worlds: Sequence[World], most: int, tolerance_rad: float, least: int = 0) -> Plan:
    """The sequence of `least` to `most` (at most 3) motions with the fewest within the tolerance.

    The number of motions is chosen in the likeliest world; that plan is then made robust in all, and compared
    with the best of one motion and with staying.
    """
    likely = [likeliest_plan(aim, worlds[0], n) for n in range(max(least, 1), most + 1)]
    chosen = fewest(likely, tolerance_rad)
    plans = [rate(aim, worlds, ())] if least == 0 else []
    for plan in {len(p.angles_rad): p for p in (*likely[:1], chosen)}.values():
        plans.append(refine(aim, worlds, plan.angles_rad, evaluations=20 * len(plan.angles_rad)))
    return fewest(plans, tolerance_rad)


def likeliest_plan(aim: Aim, world: World, motions: int) -> Plan:
    """The best sequence of `motions` (1 to 3) in one world: a grid, then a descent from its best hollows."""
    low, high = aim.reach
    target = aim.task.target_rad
    axes = [_denser_at(target, low, high, count) for count in GRID.get(motions, ())]
    shape = tuple(len(axis) for axis in axes)
    grid = [rate(aim, [world], (*before, target)) for before in product(*axes)]
    starts = [grid[k] for k in _hollows(np.array([plan.cost_rad for plan in grid]).reshape(shape))]
    if motions > 1:
        # from a wound state the first of the three is done already
        fronts = [angles[3 - motions :] for angles in _two_fronts(aim, world)]
        starts += [rate(aim, [world], (*before, target)) for before in fronts]
    starts.sort(key=lambda plan: plan.cost_rad)
    found = [refine(aim, [world], start.angles_rad, evaluations=40 * motions) for start in starts[:DESCENTS]]
    return min(found, key=lambda plan: plan.cost_rad)


def _hollows(cost_rad: Array) -> list[int]:
    """Flat places of the values no neighbour of which is lower."""
    if cost_rad.ndim == 0:
        return [0]
    from scipy.ndimage import minimum_filter

    lowest = minimum_filter(cost_rad, size=3, mode="nearest")
    return [int(k) for k in np.flatnonzero(cost_rad.ravel() <= lowest.ravel())]


def refine(aim: Aim, worlds: Sequence[World], start_rad: Sequence[float], evaluations: int) -> Plan:
    """The best plan near `start_rad`, by Nelder and Mead's simplex."""
    from scipy.optimize import minimize

    low, high = aim.reach
    target = aim.task.target_rad
    bounds = [(low, high)] * (len(start_rad) - 1)
    bounds.append((max(target - FINAL_BOUND_RAD, low), min(target + FINAL_BOUND_RAD, high)))
    start = np.clip(start_rad, *np.array(bounds).T)
    sizes = np.array([rad(4.0)] * (len(start) - 1) + [rad(1.0)])
    seen: dict[tuple[float, ...], Plan] = {}

    def value(angles: Array) -> float:
        key = tuple(angles.tolist())
        if key not in seen:
            seen[key] = rate(aim, worlds, key)
        return seen[key].cost_rad

    found = minimize(
        value,
        start,
        method="Nelder-Mead",
        bounds=bounds,
        options={
            "initial_simplex": _simplex(start, sizes, bounds),
            "maxfev": evaluations,
            "xatol": rad(0.05),
            "fatol": rad(0.01),
        },
    )
    del found
    return min(seen.values(), key=lambda plan: plan.cost_rad)


def fewest(plans: Sequence[Plan], tolerance_rad: float) -> Plan:
    """The plan with the fewest motions whose cost is within `tolerance_rad` of the best."""
    best = min(plan.cost_rad for plan in plans)
    good = [plan for plan in plans if plan.cost_rad <= best + tolerance_rad]
    return min(good, key=lambda plan: (len(plan.angles_rad), plan.cost_rad))


def _two_fronts(aim: Aim, world: World) -> list[tuple[float, float]]:
    """First two of the three angles that straighten a rigid, uniform needle, from either side.

    From the wound state, fronts at 3/4 and 1/4 of the tissue leave no net torque; with a free length l_in the
    base comes back by 1.5 (l_in + 0.375 L)/(l_in + 0.5 L) of the lag.
    """
    whole, tissue = effective_length_m(aim.task.layout), tissue_length_m(aim.task.layout)
    friction_nm = float(world.rod.slip_plus_nm[world.tissue].sum())
    twist = whole / world.model.torsional_rigidity_nm2 + world.rod.base_compliance_rad_per_nm
    lag = friction_nm * twist
    back = 1.0 - 1.5 * (whole - 0.125 * tissue) / whole
    return [(aim.task.target_rad + s * lag, aim.task.target_rad + s * back * lag) for s in (1.0, -1.0)]


def _denser_at(target: float, low: float, high: float, count: int) -> Array:
    """Angles from `low` to `high`, half of them on each side of `target` and denser near it."""
    half = np.linspace(0.0, 1.0, count // 2 + 1)[1:] ** 1.5
    below, above = target - half * (target - low), target + half * (high - target)
    return np.concatenate([below[::-1], [target], above])


def _simplex(start: Array, sizes: Array, bounds: Sequence[tuple[float, float]]) -> Array:
    corners = [start]
    for axis, (low, high) in enumerate(bounds):
        corner = start.copy()
        corner[axis] += sizes[axis] if corner[axis] + sizes[axis] <= high else -sizes[axis]
        corner[axis] = min(max(corner[axis], low), high)
        corners.append(corner)
    return np.array(corners)


def _held_torque(world: World) -> float:
    """Torque at the base of a needle that rests: the twist of its first element."""
    angle = world.state.angle_rad
    return float((angle[0] - angle[1]) * world.rod.stiffness_nm_per_rad[0])
