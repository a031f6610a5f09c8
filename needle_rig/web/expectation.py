"""What a run's model expects of its sensors while the run goes on, and whether they agree.

The needles are those that a plan is made for (`control.planning.belief`): samples of what the model file
leaves uncertain, with the friction of each run. The base as it was measured moves them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from needle_rig.control.planning.belief import Errors, first_belief, needles
from needle_rig.control.planning.effort import Effort
from needle_rig.control.reports import settled_motion
from needle_rig.control.strategies.planned import Planned
from needle_rig.control.strategy import Task, Trust
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel, load_saved
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.units import deg, nm, nmm, rad

SAMPLES = 8
"""Needles that the band is made of: as many as a plan is judged in."""
BAND_SIGMA = 2.0
ALARM_SIGMA = 3.0
"""As in the residual map; of the median over the last second, which single readings do not move."""
ALARM_S = 1.0
ALARM_READINGS = 5
WOUND_RAD_S, WOUND_SETTLE_S = rad(45.0), 3.0
"""How a needle that rests under torque is taken to have come there."""
AHEAD = 12
"""Dots of what is expected until the present motion has settled."""

Document = dict[str, Any]
Row = Sequence[float]


class Expectation:
    """One run: needles by its model, each moved as the base moved so far.

    Torques are in N·mm, angles in degrees, in rows (channels,): torque, then each Hall angle.
    """

    def __init__(self, saved: SavedModel, rest: Row) -> None:
        """`rest` is time (s), base angle, and the channels before the first motion.

        Raises BadInput, SolverError.
        """
        model, time_s = saved.model, rest[0]
        sensors = len(model.layout.sensor_positions_m)
        if sensors != len(rest) - 3:
            raise BadInput(
                f"the model {model.name} has {sensors} Hall sensors, the rig {len(rest) - 3}; choose a model"
                " that was made from runs of this rig"
            )
        trust = Trust(saved.uncertainties, saved.error_over_floor)
        task = Task(
            0.0,
            model.layout,
            model.torsional_rigidity_nm2,
            WOUND_RAD_S,
            WOUND_SETTLE_S,
            model=model,
            trust=trust,
        )
        at_rest = settled_motion(
            task,
            None,
            index=0,
            moved_s=time_s,
            time_s=time_s,
            base_angle_rad=rad(rest[1]),
            torque_nm=nm(rest[2]),
            hall_rad=tuple(rad(angle) for angle in rest[3:]),
        )
        belief = first_belief(model, trust.uncertainties, Planned.friction_scatter)
        self._needles: list[SettledNeedle] = needles(belief, task, (at_rest,), SAMPLES, Effort(math.inf))
        self._time_s, self._base_rad = time_s, rad(rest[1])
        errors = Errors()
        self.noise = np.array([nmm(errors.torque_nm), *(deg(errors.hall_rad),) * sensors])
        self._recent: list[Array] = []
        self._recent_s: list[float] = []

    def after(self, rows: Sequence[Row]) -> Document:
        """What is expected at each row, in the order of time, and how the last second was.

        Raises SolverError.
        """
        later = [row for row in rows if row[0] > self._time_s]
        if not later:
            return {"time_s": [], "mean": [], "deviation": [], "off": self._off()}
        values = np.array(later, dtype=float)
        self._needles, mean, deviation = self._moved(values[:, 0], np.radians(values[:, 1]))
        self._time_s, self._base_rad = float(values[-1, 0]), math.radians(float(values[-1, 1]))
        self._recent += list((values[:, 2:] - mean) / deviation)
        self._recent_s += [float(t) for t in values[:, 0]]
        keep = max(ALARM_READINGS, sum(t > self._time_s - ALARM_S for t in self._recent_s))
        self._recent, self._recent_s = self._recent[-keep:], self._recent_s[-keep:]
        return _told(values[:, 0], mean, deviation) | {"off": self._off()}

    def ahead(self, waypoint_deg: float, arrive_s: float, settle_s: float) -> Document:
        """What is expected until the base has come to its waypoint, and settled. Raises SolverError."""
        time_s = self._time_s + np.linspace(0.0, arrive_s + settle_s, AHEAD + 1)[1:]
        known_s = self._time_s + np.array([0.0, max(arrive_s, 1e-3)])
        path = np.interp(time_s, known_s, [self._base_rad, rad(waypoint_deg)])
        _, mean, deviation = self._moved(time_s, path)
        return _told(time_s, mean, deviation)

    def _moved(self, time_s: Array, base_rad: Array) -> tuple[list[SettledNeedle], Array, Array]:
        """The needles after this path, with mean and standard deviation of each channel, noise included."""
        path = Trial(np.r_[self._time_s, time_s], np.r_[self._base_rad, base_rad])
        moved = [needle.moved(path) for needle in self._needles]
        read = [needle.readings for needle in moved]
        every = np.array([np.column_stack([nmm(one.torque_nm[1:]), deg(one.hall_rad[1:])]) for one in read])
        return moved, every.mean(axis=0), np.hypot(every.std(axis=0), self.noise)

    def _off(self) -> list[float]:
        """By channel, the median distance over the last second, in standard deviations; 0 at the start."""
        if len(self._recent) < ALARM_READINGS:
            return [0.0] * len(self.noise)
        return [round(float(off), 2) for off in np.nanmedian(self._recent, axis=0)]


def _told(time_s: Array, mean: Array, deviation: Array) -> Document:
    return {
        "time_s": np.round(time_s, 3).tolist(),
        "mean": np.round(mean.T, 5).tolist(),
        "deviation": np.round(deviation.T, 5).tolist(),
    }


class Expectations:
    """The run that goes on now; a new one takes its place."""

    def __init__(self) -> None:
        self._run = ""
        self._of: Expectation | None = None

    def after(
        self,
        run: str,
        rows: list[list[float]],
        ahead: tuple[float, float, float] | None,
        begin: Document | None = None,
    ) -> Document:
        """Go on with `run` as far as `rows` go, or `begin` it by its model and its rest.

        Raises BadInput, SolverError.
        """
        if begin is not None:
            saved = load_saved(begin["model"], effects=begin["effects"])
            self._of = Expectation(saved, begin["rest"])
            self._run = run
        if self._of is None or self._run != run:
            raise BadInput("the beginning of this run was not seen")
        told = self._of.after(rows)
        told["ahead"] = None if ahead is None else self._of.ahead(*ahead)
        return told
