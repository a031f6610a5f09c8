"""Turn, estimate the whole shaft from base angle and torque, and turn on until the estimated tip arrives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needle_rig.control.lag import tissue_length_m
from needle_rig.control.planning.replay import replayed
from needle_rig.control.strategy import History, Strategy, Task, Waypoint
from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.physics.effects.tissue_elasticity import TissueElasticity
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.physics.solution import RodState
from needle_rig.units import nm, rad

STIFFNESS_NMM_PER_RAD_PER_100MM = 0.45
"""Middle, in the logarithm, of what soft phantoms have (PVC, gelatin: 0.1 to 2)."""
SPREAD = (0.3, 0.75)
"""Standard deviation of log friction and log stiffness of an unknown needle."""
SPREAD_OF_A_FITTED_MODEL = (0.1, 0.1)
BISECTIONS = 24


@dataclass(frozen=True)
class Estimate:
    """The shaft after the last settled motion: angles and their standard deviations, shape (nodes,)."""

    model: NeedleModel
    state: RodState
    shaft_rad: Array
    shaft_sd_rad: Array


@dataclass(frozen=True)
class Estimator(Strategy):
    """Feedback on an estimated tip, after Reed, Okamura and Cowan (2009).

    A sigma-point Kalman filter takes each settled torque in turn and corrects what is unknown of the needle,
    friction and elasticity of the tissue; the rod of the corrected model carries the whole shaft from motion
    to motion. The base then goes where that rod brings the tip to the target, until the estimated tip is
    within `tolerance_deg` or `corrections` are used up. Only base angle and torque are used. The estimate
    starts from the model of the rig where there is one.
    """

    tolerance_deg: float = 0.5
    corrections: int = 4
    torque_noise_nmm: float = 0.0005

    def __post_init__(self) -> None:
        if not self.tolerance_deg > 0 or not self.torque_noise_nmm > 0 or not 1 <= self.corrections <= 20:
            raise BadInput(
                "estimator: tolerance_deg and torque_noise_nmm must be above 0 and corrections from 1 to 20"
            )

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The turn, then corrections; None once the tip is near enough or all corrections are made."""
        if len(history) == 1:
            return Waypoint(task.target_rad, "rotate")
        estimate = self.estimate(task, history)
        error = task.target_rad - float(estimate.shaft_rad[-1])
        if abs(error) <= rad(self.tolerance_deg) or len(history) - 2 >= self.corrections:
            return None
        return Waypoint(self._base_for_tip(task, history, estimate, error), f"step_{len(history)}")

    def expected_motions(self) -> int:
        """Four: the turn and usually three corrections."""
        return 4

    def estimate(self, task: Task, history: History) -> Estimate:
        """The whole shaft after the last motion in `history`, which has at least one."""
        spread = SPREAD if task.model is None else SPREAD_OF_A_FITTED_MODEL
        mean = np.zeros(len(spread))
        covariance = np.diag(np.square(spread))
        noise = nm(self.torque_noise_nmm) ** 2
        for settled in range(2, len(history) + 1):
            points, weights = _sigma_points(mean, covariance)
            until = history[:settled]
            torques = np.array(
                [_followed(_model(task, history, point), task, until).torque_nm for point in points]
            )
            expected = weights @ torques
            off = torques - expected
            cross = (weights * off) @ (points - mean)
            gain = cross / (weights @ off**2 + noise)
            mean = mean + gain * (history[settled - 1].torque_nm - expected)
            covariance = covariance - np.outer(gain, cross)
        points, weights = _sigma_points(mean, covariance)
        shafts = np.array([_followed(_model(task, history, p), task, history).angle_rad for p in points])
        model = _model(task, history, mean)
        state = _followed(model, task, history).state
        variance = weights @ (shafts - weights @ shafts) ** 2
        return Estimate(model, state, state.angle_rad, np.sqrt(variance))

    def _base_for_tip(self, task: Task, history: History, estimate: Estimate, error: float) -> float:
        """Base angle from where the estimated rod has its tip at the target."""
        start, model = history[-1].base_angle_rad, estimate.model
        sign = math.copysign(1.0, error)

        def missing(turn: float) -> float:
            angle = start + sign * turn
            path = Trial(np.array([0.0, turn / task.speed_rad_s]), np.array([start, angle]))
            return sign * (task.target_rad - float(model.truth(path, estimate.state).tip_rad[-1]))

        low, high = 0.0, abs(error)
        limit = task.angle_limit_rad - sign * start
        while missing(high) > 0.0:
            low, high = high, 2.0 * high
            if high >= limit:
                return start + sign * limit
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if missing(middle) > 0.0 else (low, middle)
        return start + sign * high


def _sigma_points(mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Unscented points, shape (2n + 1, n), and their weights, exact to third order for a normal law."""
    size = len(mean)
    reach = math.sqrt(3.0) * np.linalg.cholesky(covariance + 1e-12 * np.eye(size)).T
    weights = np.full(2 * size + 1, 1.0 / 6.0)
    weights[0] = 1.0 - size / 3.0
    return np.vstack([mean, mean + reach, mean - reach]), weights


def _model(task: Task, history: History, point: Array) -> NeedleModel:
    """The rig's model, or an unknown needle in the same layout, at (log friction, log stiffness)."""
    friction, stiffness = np.exp(point)
    if task.model is not None:
        elastic = [e for e in task.model.effects if isinstance(e, TissueElasticity)]
        held = elastic[0].stiffness_nmm_per_rad_per_100mm if elastic else math.inf
        start, per_length = task.model, task.model.friction_n
    else:
        held = STIFFNESS_NMM_PER_RAD_PER_100MM
        per_length = abs(history[1].torque_nm) / tissue_length_m(task.layout)
        start = NeedleModel("estimator", task.layout, task.torsional_rigidity_nm2, per_length)
    values = {"friction_nmm_per_100mm": start.values()["friction_nmm_per_100mm"] * friction}
    model = start.replaced(values)
    return model.with_effects(TissueElasticity(held * stiffness)) if math.isfinite(held) else model


def _followed(model: NeedleModel, task: Task, history: History) -> SettledNeedle:
    """The needle after the last settled motion, from a relaxed shaft at rest."""
    return replayed(SettledNeedle.relaxed(model, history[0].base_angle_rad), task, history)[-1]
