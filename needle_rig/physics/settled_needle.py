"""A needle that is turned from one rest to the next: where its shaft is, and what its sensors show there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Reading, Trial
from needle_rig.physics.needle_model import NeedleModel, shown
from needle_rig.physics.rod import Rod
from needle_rig.physics.solution import RodState, Solution
from needle_rig.physics.solver import relaxed

Truth = Callable[[NeedleModel, Trial, RodState], Solution]
"""Solves a piece of path as `NeedleModel.truth` does; raises what it raises."""

_NO_PATH = Trial(np.empty(0), np.empty(0))


@dataclass(frozen=True, eq=False)
class SettledNeedle:
    """A needle model, the state of its rod, and the motion that brought it there.

    `path` is that of the base in the last motion, `solution` what the needle did meanwhile; before the first
    motion the path has no samples, only the trial's place in its series.
    """

    model: NeedleModel
    state: RodState
    path: Trial = _NO_PATH
    solution: Solution | None = None
    sensor_states: tuple[float | None, ...] = ()
    """What the sensors that remember took along to the start of `path`."""

    @classmethod
    def relaxed(cls, model: NeedleModel, base_rad: float = 0.0, place: Trial = _NO_PATH) -> SettledNeedle:
        """A needle without any twist, its base at `base_rad`, at the `place` of a trial without samples."""
        return cls(model, relaxed(model.rod(place), base_rad), place)

    def moved(self, path: Trial, truth: Truth = NeedleModel.truth) -> SettledNeedle:
        """The needle after its base went along `path`, whose first sample is where the base stands now.

        Raises what `truth` raises: SolverError, BadInput.
        """
        solution = truth(self.model, path, self.state)
        states = self._shown[1] if self.solution is not None else ()
        return replace(self, state=solution.state, path=path, solution=solution, sensor_states=states)

    def reading(self, window: slice) -> tuple[float, float, Array]:
        """Base angle, torque and Hall angles (sensors,), means over the samples `window` of the last path."""
        reading, _ = self._shown
        base_rad = float(self.path.base_angle_rad[window].mean())
        return base_rad, float(reading.torque_nm[window].mean()), reading.hall_rad[window].mean(axis=0)

    @property
    def readings(self) -> Reading:
        """What the sensors showed along the last path."""
        return self._shown[0]

    @cached_property
    def rod(self) -> Rod:
        """The model's rod."""
        return self.model.rod(self.path)

    @cached_property
    def tissue(self) -> slice:
        """Nodes from the first tissue to the tip."""
        return slice(self.rod.entry, None)

    @property
    def base_rad(self) -> float:
        """Where the base stands."""
        return float(self.path.base_angle_rad[-1])

    @property
    def torque_nm(self) -> float:
        """Torque that the base exerts on the needle."""
        return float(self._solved.torque_nm[-1])

    @property
    def hall_rad(self) -> Array:
        """True angles at the Hall sensors, (sensors,)."""
        return np.asarray(self._solved.sensor_rad[-1])

    @property
    def position_m(self) -> Array:
        """Places of the nodes, (nodes,)."""
        return self.rod.position_m

    @property
    def angle_rad(self) -> Array:
        """Angles of the nodes, (nodes,)."""
        return self.state.angle_rad

    @property
    def tip_rad(self) -> float:
        """Angle of the tip."""
        return float(self.angle_rad[self.rod.tip])

    @property
    def tip_lag_rad(self) -> float:
        """Base minus tip."""
        return self.base_rad - self.tip_rad

    @property
    def internal_torque_nm(self) -> Array:
        """Torque carried by each element between two nodes, (nodes - 1,)."""
        return self.rod.stiffness_nm_per_rad * -np.diff(self.angle_rad)

    @cached_property
    def _shown(self) -> tuple[Reading, tuple[float | None, ...]]:
        """What the sensors read along the path, and what they remember at its end."""
        truth = Reading(self.path, self._solved.torque_nm, self._solved.sensor_rad)
        return shown(self.model.acting("observe"), truth, self.sensor_states)

    @property
    def _solved(self) -> Solution:
        assert self.solution is not None, "a needle that never moved has no solution"
        return self.solution
