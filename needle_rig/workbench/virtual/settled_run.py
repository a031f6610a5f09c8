"""A rig in virtual time that knows settled motions only: a sequence costs a millisecond, not a second.

The same strategies, asked through the same interface as by the brain, against the same needle model as the
plant's. Left out are the tick and the sensors' steps, and with a `RampDrive` also the drive's lag:
nothing of them is left when a motion has settled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from needle_rig.control.compensation import DITHER_FADE_S
from needle_rig.control.ranges import MOST_MOTIONS
from needle_rig.control.reports import settled_motion
from needle_rig.control.strategy import History, SettledMotion, Strategy, Task, Waypoint
from needle_rig.errors import RigFault
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.units import nm, rad
from needle_rig.workbench.virtual.noise import Noise

WINDOW_S = 0.5
"""Length over which the sensors are averaged."""
RATE_HZ = 50.0
DITHER_POINTS = 16
DITHER_FADES = 6.0


@dataclass(frozen=True)
class Turn:
    """What the drive makes of a waypoint: the base's path from where it stood, until the sensors were read.

    They are averaged over `window` of the path's samples, where a rig would take `readings`. `moved_s` and
    `time_s` are when the motion begins and when it has settled and been read.
    """

    path: Trial
    window: slice
    readings: float
    moved_s: float
    time_s: float


class Drive(Protocol):
    """Turns the base; remembers where it stands and what the time is."""

    def rest(self) -> Turn:
        """The turn before the first motion, at whose end the first reading is taken."""

    def turn(self, waypoint: Waypoint, speed_rad_s: float, settle_s: float) -> Turn:
        """The next motion. Raises BadInput."""


@dataclass(frozen=True)
class SettledRun:
    """A sequence that ended: what the brain saw, and the needle after each motion, the rest first.

    `notes` are what the strategy said before each motion.
    """

    history: History
    needles: tuple[SettledNeedle, ...]
    notes: tuple[str, ...]

    @property
    def shaft_rad(self) -> Array:
        """True angles at the end from the first tissue to the tip, shape (nodes,)."""
        last = self.needles[-1]
        return last.angle_rad[last.tissue]

    @property
    def position_m(self) -> Array:
        """Positions along the needle of the nodes of `shaft_rad`, shape (nodes,)."""
        last = self.needles[-1]
        return last.position_m[last.tissue]

    @property
    def tip_rad(self) -> float:
        """True angle of the tip at the end."""
        return self.needles[-1].tip_rad

    @property
    def torque_nm(self) -> float:
        """True base torque at the end."""
        return self.needles[-1].torque_nm

    @property
    def time_s(self) -> float:
        """When the last motion had settled."""
        return self.history[-1].time_s

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
        off, place = np.abs(self.shaft_rad - target_rad), self.position_m
        return float(np.trapezoid(off, place) / (place[-1] - place[0]))


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
    drive = RampDrive(wound_rad, task.speed_rad_s, task.settle_s)
    needle = SettledNeedle.relaxed(model, -wound_rad)
    return carried_out(strategy, task, drive, needle, random, noise, zeroed=zeroed)


def carried_out(
    strategy: Strategy,
    task: Task,
    drive: Drive,
    needle: SettledNeedle,
    random: np.random.Generator,
    noise: Noise,
    *,
    zeroed: bool = False,
) -> SettledRun:
    """Ask `strategy` after each settled motion for the next, as the brain does, until it has none.

    Raises what strategy and drive raise, SolverError, and RigFault when it does not end.
    """
    sensors = _Sensors(task, random, noise, zeroed)
    turn = drive.rest()
    needles, notes = [needle.moved(turn.path)], []
    history: History = (sensors.settled(None, turn, needles[0]),)
    while (waypoint := strategy.next(task, history)) is not None:
        if len(history) > MOST_MOTIONS:
            raise RigFault(f"strategy {strategy.name} goes on after {MOST_MOTIONS} motions")
        turn = drive.turn(waypoint, *task.pace(waypoint))
        needles.append(needles[-1].moved(turn.path))
        notes.append(waypoint.note)
        history = (*history, sensors.settled(waypoint, turn, needles[-1]))
    return SettledRun(history, tuple(needles), tuple(notes))


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
        """Number of motions that the inner strategy expects."""
        return self.inner.expected_motions()


class RampDrive:
    """A drive that turns at the speed asked for and stops at once; the sensors are read after settling.

    Paths have samples where the base turns, stops or is read and nowhere else. Before the rest the base comes
    from −`wound_rad` at `speed_rad_s` and settles.
    """

    def __init__(self, wound_rad: float, speed_rad_s: float, settle_s: float) -> None:
        self._base_rad, self._time_s = 0.0, WINDOW_S
        winding = max(abs(wound_rad) / speed_rad_s, 1e-3)
        start = winding + settle_s
        self._rest = Trial(
            np.array([-start, winding - start, 0.0, 0.5 * WINDOW_S, WINDOW_S]),
            np.array([-wound_rad, 0.0, 0.0, 0.0, 0.0]),
        )

    def rest(self) -> Turn:
        """From the winding to the end of the first window."""
        return self._read(self._rest, 0.0)

    def turn(self, waypoint: Waypoint, speed_rad_s: float, settle_s: float) -> Turn:
        """Turn, with the waypoint's dither, settle, and let the window pass."""
        turn = waypoint.angle_rad - self._base_rad
        travel = max(abs(turn) / speed_rad_s, 1e-3)
        if waypoint.dither is None:
            times = np.array([0.0, travel])
        else:
            end = travel + DITHER_FADES * DITHER_FADE_S
            count = math.ceil(end * waypoint.dither.frequency_hz * DITHER_POINTS)
            times = np.unique(np.append(np.linspace(0.0, end, count + 1), travel))
        base = self._base_rad + turn * np.minimum(times / travel, 1.0)
        if waypoint.dither is not None:
            fade = np.exp(-np.maximum(times - travel, 0.0) / DITHER_FADE_S)
            fade[-1] = 0.0
            rate = 2.0 * math.pi * waypoint.dither.frequency_hz
            base = base + waypoint.dither.amplitude_rad * fade * np.sin(rate * times)
        still_s = times[-1] + settle_s + np.array([0.0, 0.5 * WINDOW_S, WINDOW_S])
        times = np.append(times, still_s)
        base = np.append(base, np.full(len(still_s), waypoint.angle_rad))
        path = Trial(self._time_s + times, base)
        moved_s, self._time_s = self._time_s, self._time_s + float(times[-1])
        self._base_rad = waypoint.angle_rad
        return self._read(path, moved_s)

    def _read(self, path: Trial, moved_s: float) -> Turn:
        # the window's middle stands for its mean
        return Turn(path, slice(-2, -1), WINDOW_S * RATE_HZ, moved_s, self._time_s)


class _Sensors:
    """What the sensors of a rig show on average, with noise; `zeroed`: from their first reading."""

    def __init__(self, task: Task, random: np.random.Generator, noise: Noise, zeroed: bool) -> None:
        self._task, self._random, self._noise, self._zeroed = task, random, noise, zeroed
        self._zero: tuple[float, Array | float] = (0.0, 0.0)
        self._index = 0

    def settled(self, waypoint: Waypoint | None, turn: Turn, needle: SettledNeedle) -> SettledMotion:
        """The next settled motion, after `turn` has brought the needle there."""
        base_rad, torque_nm, hall_rad = needle.reading(turn.window)
        root = math.sqrt(turn.readings)
        torque_nm += nm(self._noise.torque_nmm) * float(self._random.standard_normal()) / root
        hall_rad = hall_rad + rad(self._noise.hall_deg) * self._random.standard_normal(hall_rad.shape) / root
        if self._zeroed and waypoint is None:
            self._zero = (torque_nm, hall_rad)
        motion = settled_motion(
            self._task,
            waypoint,
            index=self._index,
            moved_s=turn.moved_s,
            time_s=turn.time_s,
            base_angle_rad=base_rad,
            torque_nm=torque_nm - self._zero[0],
            hall_rad=tuple((hall_rad - self._zero[1]).tolist()),
        )
        self._index += 1
        return motion
