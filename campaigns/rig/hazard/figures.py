"""How far the base went astray, by the plant's truth, and whether a latch held."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass
class Hull:
    """The angles between the least and the most of those added, in degrees."""

    least_deg: float = math.inf
    most_deg: float = -math.inf

    def add(self, angle_deg: float) -> None:
        """Widen it to hold `angle_deg`."""
        self.least_deg, self.most_deg = min(self.least_deg, angle_deg), max(self.most_deg, angle_deg)

    def outside_deg(self, angle_deg: float) -> float:
        """How far `angle_deg` is out of it; 0 within."""
        return max(angle_deg - self.most_deg, self.least_deg - angle_deg, 0.0)


class Commanded:
    """Everything that the host's velocities add up to since the start."""

    def __init__(self, true_deg: float) -> None:
        self._sum_deg = true_deg
        self._hull = Hull(true_deg, true_deg)

    def went(self, velocity_deg_s: float, dt_s: float) -> None:
        """A command was in force for `dt_s`."""
        self._sum_deg += velocity_deg_s * dt_s
        self._hull.add(self._sum_deg)

    def beyond_deg(self, true_deg: float) -> float:
        """How far the base is outside of it."""
        return self._hull.outside_deg(true_deg)


class Asked:
    """What a person asked for last: where the base was then, and all places it was to go to."""

    def __init__(self, true_deg: float) -> None:
        self.order(true_deg)

    def order(self, true_deg: float) -> None:
        """An order is given while the base stands at `true_deg`."""
        self._hull = Hull(true_deg, true_deg)

    def waypoint(self, angle_deg: float) -> None:
        """Where the order leads to now."""
        self._hull.add(angle_deg)

    def beyond_deg(self, true_deg: float) -> float:
        """How far the base is outside of it."""
        return self._hull.outside_deg(true_deg)


ON_ITS_WAY_MS = 50
"""A clear that an order sent just before the latch may still wake the drive, as long as a command lasts."""


@dataclass
class Latches:
    """Two promises: a latching fault keeps the supply off until a person clears it, and nothing moves that
    nobody ordered. Call `look` each millisecond."""

    woken: int = 0
    """How often the supply came on after a latching fault without a clear."""
    moved: int = 0
    """How often a drive ran or a base moved without an order, after its supply had come on without one."""
    _latched_ms: int = 0
    _awake: bool = False
    _running: bool = False
    _moving: bool = False
    _came_on: bool = False
    _pressed: bool = False

    def cleared(self) -> None:
        """A person looked."""
        self._latched_ms = 0

    def look(
        self, *, latched: bool, pressed: bool, awake: bool, running: bool, moving: bool, ordered: bool
    ) -> None:
        """`pressed`: the emergency stop; a drive that sleeps then need not latch it."""
        if awake and not self._awake:
            self.woken += self._latched_ms > ON_ITS_WAY_MS
            self._came_on = True
        if ordered:
            self._came_on = False
        else:
            self.moved += running and not self._running
            self.moved += moving and not self._moving and self._came_on
        began = latched or (pressed and not self._pressed and self._awake)
        self._latched_ms += began or self._latched_ms > 0
        self._awake, self._running, self._moving, self._pressed = awake, running, moving, pressed
