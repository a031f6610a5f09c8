"""What is known of this needle in this run: a model with uncertain parameters, corrected by what settled.

Every uncertain parameter is a standard normal number z on the parameter's own axis (its logarithm or
reciprocal where it says so). Settled torques, and Hall angles where wanted, move z by Gauss–Newton steps to
the most probable needle; the curvature there is what stays unknown.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from needle_rig.control.planning.effort import Effort, Spent
from needle_rig.control.planning.replay import READ, replayed
from needle_rig.control.strategy import History, Task
from needle_rig.errors import SolverError
from needle_rig.numerics import Array, forward_jacobian
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import FRICTION, NeedleModel
from needle_rig.physics.rod import Rod
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.units import nm, rad

ELEMENT_LENGTH_M = 5e-3
"""Coarse enough for a thousand sequences in half a second; against 0.5 mm it moves no angle by 0.01°."""
TOLERANCE_RAD = rad(0.1)
"""Of one time step, where the needle depends on rates or angles."""
STEP = 0.3
"""Of the slopes, in standard deviations."""
ITERATIONS = 4
RELAXED_NM, WOUND_NM = nm(0.002), nm(0.0005)
LONGEST_WIND_RAD = rad(540.0)
MOST_WINDS = 8


@dataclass(frozen=True)
class Errors:
    """How far settled values may be from a true model's (standard deviations): sensors, and small things."""

    torque_nm: float = nm(0.0015)
    hall_rad: float = rad(0.7)


@dataclass(frozen=True)
class Belief:
    """Most probable parameters (p,) in standard normal units, and the covariance around them (p, p)."""

    model: NeedleModel
    names: tuple[str, ...]
    spread: Array
    """Prior standard deviation of each parameter on its axis."""
    mean: Array
    covariance: Array

    def model_at(self, z: Array) -> NeedleModel:
        """The needle at `z`, kept inside the bounds of every parameter."""
        here = self.model.values()
        values = {}
        for name, spread, at in zip(self.names, self.spread, z, strict=True):
            info = self.model.info(name)
            if name == FRICTION:
                value = here[name] * math.exp(spread * at)
            elif info.scale == "linear":
                value = here[name] + spread * at
            else:
                value = info.from_scale(info.to_scale(here[name]) + spread * at)
            values[name] = (
                min(max(value, info.lower), info.upper) if value > 0 or info.lower < 0 else info.lower
            )
        return self.model.replaced(values)

    def friction_factor(self) -> tuple[float, float]:
        """Friction of this run over that of the model, and its relative standard deviation."""
        place = self.names.index(FRICTION)
        spread = float(self.spread[place])
        factor = math.exp(spread * float(self.mean[place]))
        return factor, spread * math.sqrt(float(self.covariance[place, place]))

    def samples(self, count: int) -> list[Array]:
        """`count` deterministic points of the belief, the likeliest first (the lattice of the R sequence)."""
        from scipy.special import ndtri

        size = len(self.names)
        root = 2.0
        for _ in range(30):
            root = (1.0 + root) ** (1.0 / (size + 1))
        alpha = root ** -np.arange(1.0, size + 1)
        normal = ndtri((0.5 + np.outer(np.arange(count), alpha)) % 1.0)
        factor = np.linalg.cholesky(self.covariance + 1e-12 * np.eye(size))
        return list(self.mean + normal @ factor.T)


def first_belief(model: NeedleModel, uncertainties: Mapping[str, float], friction_scatter: float) -> Belief:
    """Before anything is measured: the model file's uncertainties, and friction that differs between runs."""
    model = dataclasses.replace(
        model,
        element_length_m=max(model.element_length_m, ELEMENT_LENGTH_M),
        tolerance_rad=max(model.tolerance_rad, TOLERANCE_RAD),
    )
    names, spreads = [], []
    for name, value in model.values().items():
        known = uncertainties.get(name, 0.0)
        info = model.info(name)
        if name == FRICTION:
            spread = math.hypot(friction_scatter, known / value if value else 0.0)
        elif not (known > 0 and math.isfinite(known) and math.isfinite(value)):
            continue
        elif info.scale == "linear":
            spread = known
        elif not value:
            continue
        else:
            spread = min(known / abs(value), 0.5) if info.scale == "log" else known / value**2
        names.append(name)
        spreads.append(spread)
    size = len(names)
    return Belief(model, tuple(names), np.array(spreads), np.zeros(size), np.eye(size))


def corrected(
    belief: Belief, task: Task, history: History, errors: Errors, use_hall: bool, effort: Effort
) -> Belief:
    """The belief after the settled motions in `history`, from the first belief, as far as the effort goes."""
    if len(history) == 1 and not use_hall:
        # every needle is wound until it shows the torque at rest
        return belief
    residuals = _Residuals(belief, task, history, errors, effort, use_hall)
    z, best = belief.mean.copy(), belief
    value = math.inf
    with suppress(Spent, SolverError):
        here = residuals(z)
        jacobian = forward_jacobian(residuals, z, here, STEP)
        for _ in range(ITERATIONS):
            now = float(here @ here + z @ z)
            if now >= value - 1e-3:
                break
            value = now
            curvature = jacobian.T @ jacobian + np.eye(len(z))
            covariance = np.linalg.inv(curvature).astype(np.float64)
            best = dataclasses.replace(belief, mean=z, covariance=covariance)
            step = np.clip(z - np.linalg.solve(curvature, jacobian.T @ here + z), -6.0, 6.0) - z
            there = residuals(z + step)
            # Broyden: the slopes that explain what this step showed; others would cost a trial for each
            missed = there - here - jacobian @ step
            jacobian = jacobian + np.outer(missed, step) / max(float(step @ step), 1e-12)
            z, here = z + step, there
    return best


def after_next(
    belief: Belief, task: Task, history: History, turned_rad: float, errors: Errors, effort: Effort
) -> Belief:
    """The belief as sure as it will be when the torque after a turn to `turned_rad` has been read.

    Raises Spent, SolverError.
    """
    last = history[-1]
    held = abs(turned_rad - last.base_angle_rad) / task.speed_rad_s + task.settle_s
    turned = dataclasses.replace(
        last,
        index=last.index + 1,
        moved_s=last.time_s,
        time_s=last.time_s + held,
        base_angle_rad=turned_rad,
    )
    residuals = _Residuals(belief, task, (*history, turned), errors, effort, use_hall=False, last_only=True)
    jacobian = forward_jacobian(residuals, belief.mean, residuals(belief.mean), STEP)
    curvature = np.linalg.inv(belief.covariance) + jacobian.T @ jacobian
    return dataclasses.replace(belief, covariance=np.linalg.inv(curvature).astype(np.float64))


def needles(belief: Belief, task: Task, history: History, count: int, effort: Effort) -> list[SettledNeedle]:
    """Needles that agree with the belief, each with its shaft where `history` brought it.

    Raises Spent, SolverError.
    """
    models = [belief.model_at(z) for z in belief.samples(count)]
    return [_followed(model, task, history, effort)[-1] for model in models]


def misfit(belief: Belief, task: Task, history: History, errors: Errors, effort: Effort) -> tuple[float, str]:
    """How far the last settled motion is from the corrected model, in standard deviations, and where.

    Raises Spent, SolverError.
    """
    residuals = _Residuals(belief, task, history, errors, effort, use_hall=True, last_only=True)
    off = residuals(belief.mean)
    worst = int(np.argmax(np.abs(off)))
    return float(abs(off[worst])), residuals.sentence(worst, off[worst])


def _followed(model: NeedleModel, task: Task, history: History, effort: Effort) -> list[SettledNeedle]:
    """The needle of `model` at rest, and after each settled motion. Raises Spent, SolverError."""
    rest = history[0]
    start = _at_rest(model, task, rest.base_angle_rad, rest.torque_nm, effort)
    return replayed(start, task, history, effort.truth)


def _at_rest(
    model: NeedleModel, task: Task, base_rad: float, torque_nm: float, effort: Effort
) -> SettledNeedle:
    """A shaft at rest, base at `base_rad`: relaxed, or wound by one turn until it shows `torque_nm`."""

    def wound(turn: float) -> tuple[SettledNeedle, float]:
        times = np.array([0.0, max(abs(turn) / task.speed_rad_s, 1e-3)])
        path = Trial(
            np.append(times, times[-1] + task.settle_s), np.array([base_rad - turn, base_rad, base_rad])
        )
        needle = SettledNeedle.relaxed(model, base_rad - turn).moved(path, effort.truth)
        return needle, needle.reading(slice(-1, None))[1]

    here, shown = wound(0.0)
    missing = torque_nm - shown
    if abs(missing) < RELAXED_NM:
        return here
    sign, missing = math.copysign(1.0, missing), abs(missing)
    turn = _rigid_wind_rad(here.rod, missing)
    before_rad, before_nm = 0.0, 0.0
    low, high = 0.0, LONGEST_WIND_RAD
    for _ in range(MOST_WINDS):
        turn = min(turn, LONGEST_WIND_RAD)
        here, shown = wound(sign * turn)
        held = missing - sign * (torque_nm - shown)
        if abs(missing - held) < WOUND_NM:
            break
        low, high = (turn, high) if held < missing else (low, turn)
        gained = (held - before_nm) / (turn - before_rad)
        # a needle that slips all along holds no more however far it is turned
        if high == low or (held < missing and before_rad > 0.0 and abs(held - before_nm) < 0.1 * RELAXED_NM):
            break
        before_rad, before_nm = turn, held
        turn += (missing - held) / gained if gained > 0.0 else 0.0
        if not low < turn < high:
            turn = 0.5 * (low + high) if high < LONGEST_WIND_RAD else 2.0 * low
    return here


def _rigid_wind_rad(rod: Rod, torque_nm: float) -> float:
    """The turn after which the base of a needle in rigid tissue holds `torque_nm`: friction takes it."""
    carried_nm = np.maximum(torque_nm - np.cumsum(rod.slip_plus_nm)[:-1], 0.0)
    turn = float((carried_nm / rod.stiffness_nm_per_rad).sum())
    return turn + torque_nm * rod.base_compliance_rad_per_nm


class _Residuals:
    """What the needle at z gives minus what was measured, in standard deviations: torques, Hall angles."""

    def __init__(
        self,
        belief: Belief,
        task: Task,
        history: History,
        errors: Errors,
        effort: Effort,
        use_hall: bool,
        last_only: bool = False,
    ) -> None:
        self._belief, self._task, self._history, self._effort = belief, task, history, effort
        self._from = len(history) - 1 if last_only else 0
        self._hall = use_hall
        sensors = len(history[0].hall_rad) if use_hall else 0
        motions = history[self._from :]
        self._labels = [(m.name, -1) for m in motions] + [
            (m.name, s) for m in motions for s in range(sensors)
        ]
        torques = [m.torque_nm for m in motions]
        halls = [angle for m in motions for angle in (m.hall_rad if use_hall else ())]
        self._measured = np.array([*torques, *halls])
        self._sizes = np.array([errors.torque_nm] * len(torques) + [errors.hall_rad] * len(halls))

    def __call__(self, z: Array) -> Array:
        """At `z` (parameters,), shape (values,). Raises Spent, SolverError."""
        torques, halls = [], []
        followed = _followed(self._belief.model_at(z), self._task, self._history, self._effort)
        for number, needle in enumerate(followed[self._from :], start=self._from):
            # the rest is read where it ends
            _, torque_nm, hall_rad = needle.reading(READ if number else slice(-1, None))
            torques.append(torque_nm)
            if self._hall:
                halls.extend(hall_rad.tolist())
        off: Array = (np.array([*torques, *halls]) - self._measured) / self._sizes
        return off

    def sentence(self, place: int, off: float) -> str:
        """What is off at one place, for a person."""
        name, sensor = self._labels[place]
        size = float(off) * float(self._sizes[place])
        if sensor < 0:
            return f"after motion {name} the torque is {-size * 1e3:+.3f} N·mm from the model's"
        return f"after motion {name} Hall angle {sensor + 1} is {-math.degrees(size):+.1f}° from the model's"
