"""The needle at rest after each motion of a sequence: angle and torque along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from needle_rig.control.strategy import Strategy
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.simulation.base_drive import Motion
from needle_rig.simulation.protocol import compensation
from needle_rig.workbench.virtual.dataset import NO_NOISE, driven, planned_motions

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SettledState:
    """The needle after one motion, without noise. SI, radians."""

    name: str
    base_rad: float
    torque_nm: float
    """What the base exerts on the needle."""
    hall_rad: Array
    tip_rad: float
    position_m: Array
    """Places of the nodes, (nodes,)."""
    angle_rad: Array
    """Angles of the nodes, (nodes,)."""
    internal_torque_nm: Array
    """Torque carried by each element between two nodes, (nodes - 1,)."""

    @property
    def tip_lag_rad(self) -> float:
        """Base minus tip."""
        return self.base_rad - self.tip_rad


def sequence_states(
    model: NeedleModel,
    strategy: Strategy,
    target_deg: float,
    *,
    speed_deg_s: float = 45.0,
    settle_s: float = 3.0,
) -> tuple[SettledState, ...]:
    """The settled states of one alignment by `strategy`, one for each motion."""
    place = Trial(np.empty(0), np.empty(0))
    motions = planned_motions(
        model,
        compensation(target_deg, speed_deg_s, settle_s),
        place,
        NO_NOISE,
        np.random.default_rng(0),
        model.torsional_rigidity_nm2,
        strategy=strategy,
    )
    return motion_states(model, motions)


def motion_states(
    model: NeedleModel, motions: tuple[Motion, ...], rate_hz: float = 50.0
) -> tuple[SettledState, ...]:
    """The state at the end of each of `motions`."""
    trial = driven(motions, motions[-1].end_s, Trial(np.empty(0), np.empty(0)), rate_hz)
    truth = model.truth(trial, shaft=True)
    reading = model.observed(trial, truth)
    rod = model.rod(trial)
    assert truth.shaft_rad is not None
    states = []
    for motion in motions:
        row = int(np.searchsorted(trial.time_s, motion.end_s - 1e-9)) - 1
        shaft = np.asarray(truth.shaft_rad[row])
        states.append(
            SettledState(
                name=motion.name,
                base_rad=float(trial.base_angle_rad[row]),
                torque_nm=float(reading.torque_nm[row]),
                hall_rad=np.asarray(reading.hall_rad[row]),
                tip_rad=float(truth.tip_rad[row]),
                position_m=rod.position_m,
                angle_rad=shaft,
                internal_torque_nm=rod.stiffness_nm_per_rad * -np.diff(shaft),
            )
        )
    return tuple(states)
