"""From what somebody asks for to a task that the rig can carry out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from needle_rig.config.schema import RigConfig
from needle_rig.control.in_si import layout_of, limits_of, torsional_rigidity_nm2
from needle_rig.control.ranges import settle_fault, speed_fault
from needle_rig.control.reports import Request
from needle_rig.control.strategy import History, Strategy, Task, Trust
from needle_rig.errors import BadInput
from needle_rig.units import deg, rad

if TYPE_CHECKING:
    from needle_rig.physics.needle_model import NeedleModel


@dataclass(frozen=True)
class Before:
    """The sequence that ended last, as far as the next one goes on from it."""

    task: Task
    strategy: Strategy
    history: History

    def lag_left_rad(self) -> float:
        """How far the tip stayed behind the target, positive in the direction of the turn."""
        left_rad = self.task.target_rad - self.history[-1].hall_rad[-1]
        return left_rad * math.copysign(1.0, self.task.target_rad)


class Tasks:
    """Makes tasks of requests by a rig file and a model."""

    def __init__(self, config: RigConfig, model: NeedleModel | None, trust: Trust | None) -> None:
        self._sequence = config.sequence
        self._layout = layout_of(config)
        self._torsional_rigidity_nm2 = torsional_rigidity_nm2(config)
        self._limits = limits_of(config)
        self._tick_hz = config.tick_hz
        self._model = model
        self._trust = trust or Trust()

    def task(self, request: Request, before: Before | None) -> Task:
        """The task of `request`; BadInput when target, settling time or speed are out of range."""
        limits = self._limits
        if not math.isfinite(request.target_rad):
            raise BadInput(
                f"the target is {request.target_rad}, not an angle; give degrees, as in --target 45"
            )
        if abs(request.target_rad) > limits.angle_rad:
            raise BadInput(
                f"the target {deg(request.target_rad):g}° is outside ±{deg(limits.angle_rad):g}°"
                " (drive.angle_limit_deg)"
            )
        settle_s = self._sequence.settle_s if request.settle_s is None else request.settle_s
        speed = rad(self._sequence.speed_deg_s) if request.speed_rad_s is None else request.speed_rad_s
        fault = settle_fault(settle_s) or speed_fault(speed, limits.velocity_rad_s)
        if fault is not None:
            raise BadInput(fault)
        lag_left_rad, extra_before_deg = request.lag_left_rad, 0.0
        if lag_left_rad is None and before is not None:
            lag_left_rad = before.lag_left_rad()
            extra_before_deg = before.strategy.extra_used_deg(before.task)
        own = request.model is None
        return Task(
            target_rad=request.target_rad,
            layout=self._layout,
            torsional_rigidity_nm2=self._torsional_rigidity_nm2,
            speed_rad_s=speed,
            settle_s=settle_s,
            angle_limit_rad=limits.angle_rad,
            velocity_limit_rad_s=limits.velocity_rad_s,
            acceleration_limit_rad_s2=limits.acceleration_rad_s2,
            tick_hz=self._tick_hz,
            model=self._model if own else request.model,
            trust=self._trust if own else request.trust,
            lag_left_rad=lag_left_rad,
            extra_before_deg=extra_before_deg,
        )
