"""A rig in virtual time that knows settled motions only: a sequence costs a millisecond, not a second.

The same strategies, asked through the same interface as by the brain, against the same needle model as the
plant's. Left out are the drive's lag, the tick and the sensors' steps: nothing of them is left when a motion
has settled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from needle_rig.control.compensation import DITHER_FADE_S
from needle_rig.control.lag import lag_rad
from needle_rig.control.reports import SettledMotion
from needle_rig.control.strategy import History, Strategy, Task, Waypoint
from needle_rig.errors import RigFault
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.solver import RodState, Solution, relaxed
from needle_rig.units import nm, rad
from needle_rig.workbench.virtual.dataset import Noise

Array = npt.NDArray[np.float64]

WINDOW_S = 0.5
RATE_HZ = 50.0
DITHER_POINTS = 16
DITHER_FADES = 6.0
MOST_MOTIONS = 200


@dataclass(frozen=True)
class SettledRun:
    """A sequence that ended: what the brain saw, and the truth at its end.

    `shaft_rad` (nodes,) are the true angles from the first tissue to the tip, `tip_rad` and `torque_nm` the
    true tip and base torque. `notes` are what the strategy said before each motion.
    """

    history: History
    shaft_rad: Array
    position_m: Array
    tip_rad: float
    torque_nm: float
    time_s: float
    notes: tuple[str, ...]

    @property
    def rotations(self) -> int:
        """Number of motions."""
        return len(self.history) - 1

    @property
    def total_rotation_rad(self) -> float:
        """Sum of all turns of the base."""
        bases = [motion.base_angle_rad for motion in self.history]
        return float(np.abs(np.diff(bases)).sum())

    def worst_rad(self, target_rad: float) -> float:
        """Worst angle error from the first tissue to the tip."""
        return float(np.abs(self.shaft_rad - target_rad).max())

    def mean_rad(self, target_rad: float) -> float:
        """Mean angle error from the first tissue to the tip, by length."""
        off = np.abs(self.shaft_rad - target_rad)
        return float(np.trapezoid(off, self.position_m) / (self.position_m[-1] - self.position_m[0]))


def run_settled(
    model: NeedleModel,
    strategy: Strategy,
    task: Task,
    random: np.random.Generator,
    noise: Noise,
    *,
    wound_rad: float = 0.0,
    zeroed: bool = False,
) -> SettledRun:
    """Run `strategy` on the needle `model`, which starts relaxed, or wound by a turn of `wound_rad`.

    `zeroed`: torque and Hall angles are read from where they stood before the first motion.
    Raises what the strategy raises, and RigFault when it does not end.
    """
    strategy.check(task)
    rig = _Rig(model, task, random, noise, wound_rad)
    history: History = (rig.settled(None, zero=zeroed),)
    notes = []
    while (waypoint := strategy.next(task, history)) is not None:
        if len(history) > MOST_MOTIONS:
            raise RigFault(f"strategy {strategy.name} goes on after {MOST_MOTIONS} motions")
        rig.move(waypoint)
        notes.append(waypoint.note)
        history = (*history, rig.settled(waypoint))
    rod = model.rod(rig.trial(np.empty(0), np.empty(0)))
    state = rig.solution.state
    return SettledRun(
        history,
        state.angle_rad[rod.entry :],
        rod.position_m[rod.entry :],
        float(state.angle_rad[rod.tip]),
        float(rig.solution.torque_nm[-1]),
        rig.time_s,
        tuple(notes),
    )


@dataclass(frozen=True)
class Recorded(Strategy):
    """A strategy whose motions ended where the base was recorded, as far as it was."""

    inner: Strategy
    base_deg: Mapping[str, float]

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The strategy's next motion, to the recorded angle."""
        waypoint = self.inner.next(task, history)
        if waypoint is None or waypoint.name not in self.base_deg:
            return waypoint
        return replace(waypoint, angle_rad=rad(self.base_deg[waypoint.name]))

    def expected_motions(self) -> int:
        """As many as the strategy's."""
        return self.inner.expected_motions()


class _Rig:
    def __init__(
        self, model: NeedleModel, task: Task, random: np.random.Generator, noise: Noise, wound_rad: float
    ) -> None:
        self._model, self._task, self._random, self._noise = model, task, random, noise
        self.base_rad, self.time_s, self._moved_s = 0.0, 0.0, 0.0
        self._index = -1
        winding = max(abs(wound_rad) / task.speed_rad_s, 1e-3)
        start = winding + task.settle_s
        self._path = self.trial(
            np.array([-start, winding - start, 0.0, 0.5 * WINDOW_S, WINDOW_S]),
            np.array([-wound_rad, 0.0, 0.0, 0.0, 0.0]),
        )
        rod = model.rod(self.trial(np.empty(0), np.empty(0)))
        self.solution: Solution = model.truth(self._path, relaxed(rod, -wound_rad))
        self.time_s = WINDOW_S
        self._zero: tuple[float, Array] = (0.0, np.zeros(len(model.layout.sensor_positions_m)))

    def trial(self, time_s: Array, base_rad: Array) -> Trial:
        return Trial(time_s, base_rad)

    def move(self, waypoint: Waypoint) -> None:
        """Turn, settle, and let the window pass."""
        task = self._task
        speed = task.speed_rad_s if waypoint.speed_rad_s is None else waypoint.speed_rad_s
        settle = task.settle_s if waypoint.settle_s is None else waypoint.settle_s
        turn = waypoint.angle_rad - self.base_rad
        travel = max(abs(turn) / speed, 1e-3)
        if waypoint.dither is None:
            times = np.array([0.0, travel])
        else:
            end = travel + DITHER_FADES * DITHER_FADE_S
            count = math.ceil(end * waypoint.dither.frequency_hz * DITHER_POINTS)
            times = np.unique(np.append(np.linspace(0.0, end, count + 1), travel))
        base = self.base_rad + turn * np.minimum(times / travel, 1.0)
        if waypoint.dither is not None:
            fade = np.exp(-np.maximum(times - travel, 0.0) / DITHER_FADE_S)
            fade[-1] = 0.0
            rate = 2.0 * math.pi * waypoint.dither.frequency_hz
            base = base + waypoint.dither.amplitude_rad * fade * np.sin(rate * times)
        held = times[-1] + settle + np.array([0.0, 0.5 * WINDOW_S, WINDOW_S])
        times = np.append(times, held)
        base = np.append(base, np.full(len(held), waypoint.angle_rad))
        state: RodState = self.solution.state
        self._path = self.trial(self.time_s + times, base)
        self.solution = self._model.truth(self._path, state)
        self._moved_s, self.time_s = self.time_s, self.time_s + float(times[-1])
        self.base_rad = waypoint.angle_rad

    def settled(self, waypoint: Waypoint | None, *, zero: bool = False) -> SettledMotion:
        """What the sensors show of the last motion, on average over its window; `zero` zeroes them there."""
        reading = self._model.observed(self._path, self.solution)
        self._index += 1
        share = 1.0 / math.sqrt(WINDOW_S * RATE_HZ)
        torque = float(reading.torque_nm[-2])
        torque += nm(self._noise.torque_nmm) * share * float(self._random.standard_normal())
        hall = reading.hall_rad[-2]
        hall = hall + rad(self._noise.hall_deg) * share * self._random.standard_normal(hall.shape)
        if zero:
            self._zero = (torque, hall)
        torque, hall = torque - self._zero[0], hall - self._zero[1]
        base = self.base_rad
        return SettledMotion(
            index=self._index,
            name="rest" if waypoint is None else waypoint.name,
            moved_s=self._moved_s,
            time_s=self.time_s,
            waypoint_rad=base,
            base_angle_rad=base,
            torque_nm=torque,
            hall_rad=tuple(hall.tolist()),
            predicted_lag_rad=lag_rad(torque, self._task.layout, self._task.torsional_rigidity_nm2),
            tip_lag_rad=base - float(hall[-1]) if len(hall) else math.nan,
        )
