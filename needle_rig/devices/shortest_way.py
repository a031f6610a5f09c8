"""The shortest way through a link, and the rate of the node's clock, learnt from when frames come."""

from __future__ import annotations

import math
from collections import deque

STEP_S = 0.02
"""Jitter of a healthy link: a USB adapter hands over every 16 ms."""
CRYSTAL_TOLERANCE = 6e-4
"""Rate of a node with a crystal: 100 ppm, and 500 ppm by which a time service may steer the host's clock."""
RC_TOLERANCE = 0.02
"""Rate of a node without a crystal."""
_BLOCK_S = 1.0
"""Of each block the frame counts that came soonest."""
_LEARNT = 10
"""Blocks after which the rate is known."""
_BLOCKS = 20
"""Blocks that the rate is taken from: in half of that it moves by less than _SLACK."""
_SOONEST_S = 3e-3
"""The soonest frames of blocks differ by less, at 50 frames a second handed over every 16 ms."""
_DRIFT_PER_S = 20e-6
"""So fast a rate moves as its node warms up: 150 ppm/K at 8 K a minute, an RC oscillator after power on."""
_SLACK = 200e-6
"""What the rate moves by until it is learnt anew; so a way that was once too short is forgotten."""


class ShortestWay:
    """Least offset (host minus node time) that a frame may have; a frame above it is late by as much.

    While the rate is not known, the offset may rise by `tolerance`. From ten seconds on it rises by the rate
    that was learnt, which may then move by 20 ppm/s. Blocks whose soonest frame is late teach nothing.
    """

    def __init__(self, offset_s: float, now_s: float, tolerance: float) -> None:
        self._tolerance = tolerance
        self._offset_s, self._time_s = offset_s, now_s
        self._before_s = offset_s
        self._late_s = math.inf
        self.forget(now_s)

    def forget(self, now_s: float) -> None:
        """Learn the rate anew."""
        self._known = False
        self._rate = self._most = self._tolerance
        self._soonest: deque[tuple[float, float]] = deque(maxlen=_BLOCKS)
        self._begin_block(now_s)

    def at(self, now_s: float) -> float:
        """The least offset at this time, seconds."""
        elapsed_s = now_s - self._time_s
        if not self._known:
            return self._offset_s + self._tolerance * elapsed_s
        moved = self._rate + _SLACK + _DRIFT_PER_S * elapsed_s / 2
        return self._offset_s + (moved if moved < self._tolerance else self._tolerance) * elapsed_s

    def take(self, offset_s: float, now_s: float) -> float:
        """How late a frame with this offset is, seconds; two in a row must agree on a shorter way."""
        least_s = self.at(now_s)
        both_s = max(offset_s, self._before_s)
        self._before_s = offset_s
        if both_s < least_s - STEP_S:
            self.forget(now_s)
        self._offset_s, self._time_s = min(least_s, both_s), now_s
        if both_s - self._offset_s <= self._late_s:
            self._late_s, self._point = both_s - self._offset_s, (now_s, both_s)
        if now_s >= self._block_end_s:
            self._end_block(now_s)
        return max(offset_s - self._offset_s, 0.0)

    def _begin_block(self, now_s: float) -> None:
        self._begun_s, self._block_end_s = now_s, now_s + _BLOCK_S
        self._late_s = math.inf
        self._point = (now_s, math.inf)

    def _end_block(self, now_s: float) -> None:
        if self._late_s <= STEP_S:
            self._soonest.append(self._point)
        if self._late_s <= STEP_S and len(self._soonest) >= _LEARNT:
            self._learn(now_s)
        self._begin_block(now_s)

    def _learn(self, now_s: float) -> None:
        rate, span_s = _slope(self._soonest)
        if not self._known:
            self._most = math.inf
        moved = self._most + _DRIFT_PER_S * (now_s - self._begun_s)
        self._most = min(moved, rate + _SOONEST_S / span_s, self._tolerance)
        self._rate = max(min(rate, self._most), -self._tolerance)
        if not self._known:
            self._known = True
            self._offset_s = min(
                offset_s + self._rate * (now_s - time_s) for time_s, offset_s in self._soonest
            )


def _slope(points: deque[tuple[float, float]]) -> tuple[float, float]:
    """Least squares of offset over time, and the time between the first and the last, seconds."""
    count = len(points)
    middle_s, mean_s = sum(t for t, _ in points) / count, sum(x for _, x in points) / count
    spread = sum((t - middle_s) ** 2 for t, _ in points)
    return sum((t - middle_s) * (x - mean_s) for t, x in points) / spread, points[-1][0] - points[0][0]
