"""A needle that costs half of the finite elements: one torsion spring and one place that slips."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.solution import RodState, Solution


@dataclass(frozen=True)
class SpringNeedle(NeedleModel):
    """The twist keeps one shape along the shaft, and grows until the tip slips."""

    shares: tuple[float, ...] = ()
    """Share of the whole twist that lies between the base and each node."""
    sensor_shares: tuple[float, ...] = ()
    stiffness_nm: float = 0.0
    """Torque at the base for a whole twist of 1 rad."""
    most_rad: float = math.inf
    """Whole twist at which the tip slips."""

    @classmethod
    def slipping(cls, model: NeedleModel, nodes: int) -> SpringNeedle:
        """`model` with the shape that its twist has when all of it slips, and tissue that does not give way.

        Torque and twist before the first Hall sensor, by which a host judges, fit together as in `model`.
        """
        layout = model.layout
        place_m = np.linspace(0.0, layout.needle_length_m, nodes)
        held_m = np.sum([np.clip(place_m, a, b) - a for a, b in layout.tissue_sections_m], axis=0)
        torque_nm = model.friction_n * (held_m[-1] - held_m)
        twist_rad = np.r_[0.0, np.cumsum(0.5 * (torque_nm[1:] + torque_nm[:-1]) * np.diff(place_m))]
        twist_rad /= model.torsional_rigidity_nm2
        most_rad = float(twist_rad[-1])
        return cls._of(model, place_m, twist_rad / most_rad, float(torque_nm[0]) / most_rad, most_rad)

    @classmethod
    def caught(cls, model: NeedleModel, nodes: int) -> SpringNeedle:
        """`model` whose tip is held fast: it twists evenly."""
        length_m = model.layout.needle_length_m
        stiffness_nm = model.torsional_rigidity_nm2 / length_m
        return cls._of(model, np.linspace(0.0, length_m, nodes), np.linspace(0.0, 1.0, nodes), stiffness_nm)

    @classmethod
    def _of(
        cls,
        model: NeedleModel,
        place_m: Array,
        shares: Array,
        stiffness_nm: float,
        most_rad: float = math.inf,
    ) -> SpringNeedle:
        at_sensors = np.interp(model.layout.sensor_positions_m, place_m, shares)
        return cls(
            **{f.name: getattr(model, f.name) for f in fields(NeedleModel)},
            shares=tuple(shares.tolist()),
            sensor_shares=tuple(at_sensors.tolist()),
            stiffness_nm=stiffness_nm,
            most_rad=most_rad,
        )

    def truth(self, trial: Trial, state: RodState | None = None, **_: object) -> Solution:
        """What it does at the end of `trial`, of which the path between does not matter while it turns one
        way."""
        assert state is not None
        base_rad = float(trial.base_angle_rad[-1])
        twist_rad = min(max(base_rad - float(state.angle_rad[-1]), -self.most_rad), self.most_rad)
        angle_rad = base_rad - twist_rad * np.array(self.shares)
        return Solution(
            time_s=trial.time_s[-1:],
            torque_nm=np.array([self.stiffness_nm * twist_rad]),
            sensor_rad=base_rad - twist_rad * np.array([self.sensor_shares]),
            tip_rad=angle_rad[-1:],
            shaft_rad=None,
            state=RodState(angle_rad, *(getattr(state, f.name) for f in fields(RodState)[1:])),
            steps=1,
            solves=1,
        )
