"""Looks for the fewest and shortest rotations that leave the shaft straight at the target."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from needle_rig.control.lag import effective_length_m, tissue_length_m
from needle_rig.control.planning.effort import Effort, Spent
from needle_rig.control.strategy import Task
from needle_rig.errors import SolverError
from needle_rig.numerics import Array, forward_jacobian
from needle_rig.physics.effect import Trial
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.units import rad

TORQUE_WEIGHT = 0.2
"""Of the lag that the torque left stands for, beside the worst angle error."""
BASE_WEIGHT = 0.05
"""Of the base's distance from the target."""
TURN_PRICE = 0.005
"""Of the total rotation: 100° more must take 0.5° off the error."""
FINAL_BOUND_RAD = rad(10.0)
FIRST_SCAN, NEXT_SCAN = 31, 17
SQUARES_EVALUATIONS = 6
POLISH_EVALUATIONS, ROBUST_EVALUATIONS = 10, 12
"""A motion, in one needle and in all."""
SCAN_SHARE = 0.3
"""Of the effort left: the rest is for descents from what a scan found."""
STEP_RAD = rad(1.0)
"""Of the slopes."""
CUT_RAD = 100.0
"""What every angle is said to be off where a sequence could not be followed."""


@dataclass(frozen=True)
class Aim:
    """What every plan must keep to, and what its rotations cost; the window is what follows each settling."""

    task: Task
    base_rad: float
    overshoot_rad: float
    settle_s: float
    quantile: float
    rotation_price_rad: float
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
    """What a sequence leaves in each needle, (needles,): angles from the target, torque at the base."""

    worst_rad: Array
    torque_nm: Array
    off_rad: Array
    """Of every node from the first tissue to the tip in the first needle, shape (nodes,)."""


@dataclass(frozen=True)
class Plan:
    """Base angles to go to, and what they should leave."""

    angles_rad: tuple[float, ...]
    cost_rad: float
    ends: Ends

    @property
    def followed(self) -> bool:
        """Whether every needle could be followed to its end."""
        return float(self.ends.worst_rad.max()) < CUT_RAD


def carry_out(
    aim: Aim, needles: Sequence[SettledNeedle], angles_rad: Sequence[float], effort: Effort
) -> Ends:
    """What turning the base through `angles_rad` leaves in each needle. Raises Spent."""
    times, path = [0.0], [aim.base_rad]
    last = len(angles_rad) - 1
    for place, angle in enumerate(angles_rad):
        travel = max(abs(angle - path[-1]) / aim.task.speed_rad_s, 1e-3)
        settle = (aim.task.settle_s if place == last else aim.settle_s) + aim.window_s
        times += [times[-1] + travel, times[-1] + travel + settle]
        path += [angle, angle]
    time_s, base_rad = np.array(times), np.array(path)
    worst, torque = np.empty(len(needles)), np.empty(len(needles))
    for k, needle in enumerate(needles):
        if angles_rad:
            try:
                solution = effort.truth(needle.model, Trial(time_s, base_rad), needle.state)
                shaft, torque[k] = solution.state.angle_rad, solution.torque_nm[-1]
            except SolverError:
                shaft, torque[k] = np.full_like(needle.state.angle_rad, aim.task.target_rad + CUT_RAD), 0.0
        else:
            shaft, torque[k] = needle.state.angle_rad, _held_torque(needle)
        off = shaft[needle.tissue] - aim.task.target_rad
        worst[k] = np.abs(off).max()
        if k == 0:
            first = off
    return Ends(worst, torque, first)


def cost(aim: Aim, angles_rad: Sequence[float], ends: Ends) -> float:
    """The quantile over the needles of worst error and torque left, and the price of the rotations, radians.

    A price, and not a tolerance: what was the best way to go on stays so after its first motion.
    """
    task = aim.task
    each = ends.worst_rad + TORQUE_WEIGHT * np.abs(_lag(aim, ends.torque_nm))
    path = (aim.base_rad, *angles_rad)
    turned = float(np.abs(np.diff(path)).sum())
    off = abs(path[-1] - task.target_rad)
    value = float(np.quantile(each, aim.quantile)) if len(each) > 1 else float(each[0])
    return value + BASE_WEIGHT * off + aim.rotation_price_rad * len(angles_rad) + TURN_PRICE * turned


def _lag(aim: Aim, torque_nm: Array) -> Array:
    return torque_nm * effective_length_m(aim.task.layout) / aim.task.torsional_rigidity_nm2


def rate(
    aim: Aim, needles: Sequence[SettledNeedle], angles_rad: Sequence[float] | Array, effort: Effort
) -> Plan:
    """The plan `angles_rad` with what it leaves. Raises Spent."""
    angles = tuple(float(a) for a in angles_rad)
    ends = carry_out(aim, needles, angles, effort)
    return Plan(angles, cost(aim, angles, ends), ends)


def cheapest(plans: Sequence[Plan]) -> Plan:
    """The plan of the lowest cost."""
    return min(plans, key=lambda plan: plan.cost_rad)


def likeliest_plans(aim: Aim, needle: SettledNeedle, most: int, effort: Effort) -> list[Plan]:
    """The best sequence of 1, 2, … motions in one needle, until one more motion is not worth its price.

    Each is a descent in all angles, from the sequence before with one more turn before its first or its last
    motion, and for two reversals from those of a rigid needle as well. Raises Spent when not one was tried.
    """
    target = aim.task.target_rad
    found = [_descend(aim, needle, (target,), effort)]
    while len(found) < most:
        *turns, last = found[-1].angles_rad
        # one more reversal comes to the end from the other side, where play is to be taken up the other way
        axis = _denser_at(target, *aim.reach, NEXT_SCAN if turns else FIRST_SCAN)
        scans = [[(*turns, x, 2.0 * target - last) for x in axis]]
        if turns:
            scans.append([(x, *turns, last) for x in _denser_at(aim.base_rad, *aim.reach, NEXT_SCAN)])
        tried: list[Plan] = []
        try:
            tried += [_scan(aim, needle, scan, effort.part(SCAN_SHARE)) for scan in scans]
            starts: list[tuple[float, ...]] = [plan.angles_rad for plan in tried]
            if len(turns) == 1:
                starts += _two_fronts(aim, needle)
            for start in starts:
                tried.append(_descend(aim, needle, start, effort))
        except Spent:
            return [*found, cheapest(tried)] if tried else found
        found.append(cheapest(tried))
        if len(found) > 2 and found[-1].cost_rad > found[-2].cost_rad:
            break
    return found


def _scan(aim: Aim, needle: SettledNeedle, scan: Sequence[tuple[float, ...]], effort: Effort) -> Plan:
    """The best of `scan` in one needle. Raises Spent when not one was tried."""
    rated = _Rated(aim, [needle], effort)
    # golden steps: a scan cut short has looked everywhere, if less closely
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    order = np.argsort(np.argsort((golden * np.arange(len(scan))) % 1.0))
    with suppress(Spent):
        for place in order:
            rated(scan[place])
    return rated.best()


def _two_fronts(aim: Aim, needle: SettledNeedle) -> list[tuple[float, float, float]]:
    """The three angles that straighten a rigid, uniform needle, from either side; the lag is this needle's.

    From the wound state, fronts at 3/4 and 1/4 of the tissue leave no net torque; with a free length l_in the
    base comes back by 1.5 (l_in + 0.375 L)/(l_in + 0.5 L) of the lag.
    """
    whole, tissue = effective_length_m(aim.task.layout), tissue_length_m(aim.task.layout)
    rod = needle.rod
    carried_nm = np.cumsum(rod.slip_plus_nm[::-1])[::-1]
    lag = float((carried_nm[1:] / rod.stiffness_nm_per_rad).sum())
    lag += float(carried_nm[0]) * rod.base_compliance_rad_per_nm
    back = 1.0 - 1.5 * (whole - 0.125 * tissue) / whole if whole else 1.0
    target = aim.task.target_rad
    return [(target + s * lag, target + s * back * lag, target) for s in (1.0, -1.0)]


def _descend(aim: Aim, needle: SettledNeedle, start_rad: Sequence[float], effort: Effort) -> Plan:
    """The best plan near `start_rad` in one needle: least squares of all nodes first, for speed.

    Raises Spent when not one was tried.
    """
    from scipy.optimize import Bounds, least_squares

    start, bounds = _bounded(aim, start_rad)
    rated = _Rated(aim, [needle], effort)

    def off(angles: Array) -> Array:
        plan = rated(angles)
        ends = plan.ends
        base = plan.angles_rad[-1] - aim.task.target_rad
        torque = TORQUE_WEIGHT * _lag(aim, ends.torque_nm)
        return np.concatenate([ends.off_rad / math.sqrt(len(ends.off_rad)), torque, [BASE_WEIGHT * base]])

    def slopes(angles: Array) -> Array:
        return forward_jacobian(off, angles, off(angles), STEP_RAD, *bounds.T)

    with suppress(Spent):
        least_squares(
            off,
            start,
            slopes,
            bounds=Bounds(*bounds.T),
            max_nfev=SQUARES_EVALUATIONS,
            xtol=1e-3,
            ftol=1e-2,
        )
        return refine(aim, [needle], rated.best().angles_rad, POLISH_EVALUATIONS, effort)
    return rated.best()


def refine(
    aim: Aim, needles: Sequence[SettledNeedle], start_rad: Sequence[float], evaluations: int, effort: Effort
) -> Plan:
    """The best plan near `start_rad`, by Nelder and Mead's simplex, in `evaluations` a motion.

    Raises Spent when not one was tried.
    """
    from scipy.optimize import Bounds, minimize

    start, bounds = _bounded(aim, start_rad)
    sizes = np.array([rad(4.0)] * (len(start) - 1) + [rad(1.0)])
    rated = _Rated(aim, needles, effort)

    def cost_rad(angles: Array) -> float:
        return rated(angles).cost_rad

    with suppress(Spent):
        minimize(
            cost_rad,
            start,
            method="Nelder-Mead",
            bounds=Bounds(*bounds.T),
            options={
                "initial_simplex": _simplex(start, sizes, bounds),
                "maxfev": evaluations * len(start),
                "xatol": rad(0.05),
                "fatol": rad(0.01),
            },
        )
    return rated.best()


class _Rated:
    """Plans rated so far, each of them once."""

    def __init__(self, aim: Aim, needles: Sequence[SettledNeedle], effort: Effort) -> None:
        self._aim, self._needles, self._effort = aim, needles, effort
        self._plans: dict[tuple[float, ...], Plan] = {}

    def __call__(self, angles_rad: Sequence[float] | Array) -> Plan:
        """The plan `angles_rad` (motions,) with what it leaves. Raises Spent."""
        key = tuple(float(angle) for angle in angles_rad)
        if key not in self._plans:
            self._plans[key] = rate(self._aim, self._needles, key, self._effort)
        return self._plans[key]

    def best(self) -> Plan:
        """The cheapest of them. Raises Spent when there is none."""
        if not self._plans:
            raise Spent
        return cheapest(list(self._plans.values()))


def _bounded(aim: Aim, angles_rad: Sequence[float]) -> tuple[Array, Array]:
    """The angles kept within their bounds, and those, shapes (motions,) and (motions, 2)."""
    low, high = aim.reach
    target = aim.task.target_rad
    bounds = np.array([(low, high)] * len(angles_rad))
    bounds[-1] = max(target - FINAL_BOUND_RAD, low), min(target + FINAL_BOUND_RAD, high)
    return np.clip(angles_rad, *bounds.T), bounds


def _denser_at(target: float, low: float, high: float, count: int) -> Array:
    """Angles from `low` to `high`, half of them on each side of `target` and denser near it."""
    half = np.linspace(0.0, 1.0, count // 2 + 1)[1:] ** 1.5
    below, above = target - half * (target - low), target + half * (high - target)
    return np.concatenate([below[::-1], [target], above])


def _simplex(start: Array, sizes: Array, bounds: Array) -> Array:
    corners = [start]
    for axis, (low, high) in enumerate(bounds):
        corner = start.copy()
        corner[axis] += sizes[axis] if corner[axis] + sizes[axis] <= high else -sizes[axis]
        corner[axis] = min(max(corner[axis], low), high)
        corners.append(corner)
    return np.array(corners)


def _held_torque(needle: SettledNeedle) -> float:
    """Torque at the base of a needle that rests: the twist of its first element."""
    angle = needle.state.angle_rad
    return float((angle[0] - angle[1]) * needle.rod.stiffness_nm_per_rad[0])
