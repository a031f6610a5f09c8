"""The firmware's motion monitor in Python (firmware/core/nr_motion.c): what was asked against what moved."""

from __future__ import annotations

import enum
from dataclasses import dataclass

Q8 = 256
UNITS_PER_MDEG = 10_000_000
SLOWEST_TURN = 3000
FARTHEST_MDEG = 1_000_000


class Verdict(enum.Enum):
    """What the shaft does against what was asked of it."""

    FOLLOWS = 0
    STALLS = 1
    RUNS = 2
    AGAINST = 4
    UNASKED = 8


@dataclass(frozen=True)
class MotionSettings:
    """The firmware's defaults; see firmware/core/nr_motion.h."""

    lag_us: int = 20_000
    memory_us: int = 400_000
    slack_us: int = 50_000
    rest_us: int = 100_000
    floor_mdeg: int = 250
    rest_mdeg: int = 1000
    speed_us: int = 5000
    speed_percent: int = 130
    speed_floor: int = 150_000


class MotionMonitor:
    """Follows one shaft. Integers, as in the firmware: mdeg, 1e-4 deg/s, `following` in 1e-10 deg."""

    def __init__(self, settings: MotionSettings | None = None) -> None:
        self._settings = settings or MotionSettings()
        self.rest(0)

    def rest(self, angle_mdeg: int) -> None:
        """The shaft stands at `angle_mdeg` and nothing is asked."""
        self._angle_mdeg = angle_mdeg
        self.expected_q8 = self._turning = self.pace_q8 = self.following = self._unasked_us = 0
        self.resting = True

    def rename(self, angle_mdeg: int) -> None:
        """The same place has another angle from now on."""
        self._angle_mdeg = angle_mdeg

    def step(self, elapsed_us: int, angle_mdeg: int, asked: int) -> Verdict:
        """What became of `asked`, which was in force for `elapsed_us` until now."""
        settings = self._settings
        moved = min(max(angle_mdeg - self._angle_mdeg, -FARTHEST_MDEG), FARTHEST_MDEG) * UNITS_PER_MDEG
        self._angle_mdeg = angle_mdeg
        if asked and self.resting:
            self.resting, self.following = False, 0
        self._unasked_us = 0 if asked else self._unasked_us + elapsed_us
        self.expected_q8 = _closer(self.expected_q8, asked * Q8, elapsed_us, settings.lag_us)
        self.following += quotient(self.expected_q8 * elapsed_us, Q8) - moved
        if elapsed_us > 0:
            turn = quotient(moved, elapsed_us)
            self._turning = _closer(self._turning, turn, elapsed_us, settings.speed_us)
        self.pace_q8 = max(_closer(self.pace_q8, 0, elapsed_us, settings.memory_us), abs(asked) * Q8)
        if self.resting:
            far = abs(self.following) > settings.rest_mdeg * UNITS_PER_MDEG
            return Verdict.UNASKED if far else Verdict.FOLLOWS
        fastest = self.pace_q8 // Q8 * settings.speed_percent // 100 + settings.speed_floor
        farthest = settings.floor_mdeg * UNITS_PER_MDEG + self.pace_q8 * settings.slack_us // Q8
        wrong = abs(self._turning) > fastest or abs(self.following) > farthest
        verdict = self._named() if wrong else Verdict.FOLLOWS
        if self._unasked_us >= settings.rest_us:
            self.rest(angle_mdeg)
        return verdict

    def _named(self) -> Verdict:
        way = self.expected_q8
        back = -self._turning if way > 0 else self._turning
        if way and back > abs(way) // Q8 // 4 + SLOWEST_TURN:
            return Verdict.AGAINST
        return Verdict.RUNS if way == 0 or (way > 0) != (self.following > 0) else Verdict.STALLS


def quotient(value: int, by: int) -> int:
    """Division as in C: towards zero."""
    return value // by if value >= 0 else -(-value // by)


def _closer(value: int, goal: int, elapsed_us: int, lag_us: int) -> int:
    """`value` on its way to `goal`, by the share of the lag that passed."""
    if elapsed_us >= lag_us:
        return goal
    return value + quotient((goal - value) * elapsed_us, lag_us)
