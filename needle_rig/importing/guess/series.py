"""A column on its clock, and how the motions of two of them compare."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needle_rig.importing import names, signals
from needle_rig.importing.recording import Column
from needle_rig.importing.unit_text import Unit, unit_of
from needle_rig.numerics import Array

LARGEST_NUMBER = 1e30
"""Largest number in any unit: above it a bit is wrong, and its square overflows."""
COMMON = 0.01
"""Difference of two records of one quantity, over its span; a practice needle's loop leaves 0.09."""


@dataclass(frozen=True)
class Series:
    """A column of a file on its clock in seconds, thinned to what is looked at."""

    column: Column
    clock: str
    time_s: Array
    values: Array

    @property
    def span(self) -> float:
        """Largest minus smallest value, in the unit of the file."""
        known = self.values[np.isfinite(self.values)]
        return float(np.ptp(known)) if len(known) else 0.0


@dataclass(frozen=True)
class UnitGuess:
    """A unit found for a column; None where it cannot be told."""

    unit: Unit | None
    why: str
    doubt: str = ""


def values_at(s: Series, other: Series) -> Array:
    """`other` at the times of `s`, NaN outside of its own."""
    if s.clock == other.clock and len(s.values) == len(other.values):
        return other.values
    known = np.isfinite(other.values)
    return np.interp(s.time_s, other.time_s[known], other.values[known], left=math.nan, right=math.nan)


def lag_of(leader: Series, follower: Series) -> float:
    """How far an angle comes after another; 0 on different clocks, where it is a question of the clocks."""
    if leader.clock != follower.clock:
        return 0.0
    every = max(1, len(leader.values) // 4000)
    return signals.lag_share(_smooth(leader.values)[::every], _smooth(follower.values)[::every])


def _smooth(values: Array) -> Array:
    width = max(1, min(len(values) // 400, 25))
    known = np.isfinite(values)
    if not known.all():
        values = np.interp(np.arange(len(values)), np.flatnonzero(known), values[known])
    if width == 1:
        return values
    total = np.cumsum(np.concatenate(([0.0], values)))
    return np.asarray((total[width:] - total[:-width]) / width)


def span_ratio(a: Series, b: Series) -> float:
    """Span of `b` over that of `a`; 0 where `a` has none."""
    return b.span / a.span if a.span else 0.0


def from_start(s: Series) -> Array:
    """Values relative to those at rest before the first motion."""
    return signals.from_rest(s.values, signals.rest_before_motion(s.values))


def torque_from_start(base: Series, s: Series) -> Array:
    """A torque at the times of the base, relative to that at rest before the base's first motion."""
    return signals.from_rest(values_at(base, s), signals.rest_before_motion(base.values))


def written_dimension(column: Column) -> str:
    """Dimension of the unit that is written in the file; empty where none is known."""
    unit = unit_of(column.unit)
    return "" if unit is None else unit.dimension


def is_copy(base: Series, s: Series) -> bool:
    """Whether a column is the base's angle once more."""
    left = signals.difference_share(s.time_s, s.values, base.time_s, base.values)
    return left < COMMON and (s.clock != base.clock or names.is_base(s.column.name))
