"""A column on its clock, and how the motions of two of them compare."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needle_rig.importing import names, signals
from needle_rig.importing.recording import Column
from needle_rig.importing.unit_text import Unit, is_counted, unit_of
from needle_rig.numerics import Array

LARGEST_NUMBER = 1e30
"""Largest number in any unit: above it a bit is wrong, and its square overflows."""
FEWEST = 10
"""Known samples of a column from which anything is concluded."""
LEAST_FILLED = 0.9
"""Share of the rows below which a column keeps its own times; single samples that are lost leave more."""
TURN_RAD = 2.0 * math.pi
ROUNDING = 1e-5
"""Of the span: what the digits of a file leave between two columns of one reading; noise is more."""
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


def series_of(column: Column, clock: str, time_s: Array) -> Series:
    """A column at its `time_s` (rows,), which may be NaN; angles that wrap are unwrapped, then thinned.

    One that stands in few of the rows, as topics of their own rates side by side, has its own times.
    """
    there = np.isfinite(time_s)
    filled = there & np.isfinite(column.values)
    share = filled.sum() / max(1, there.sum())
    place = np.flatnonzero(filled if share < LEAST_FILLED and filled.sum() >= FEWEST else there)
    values = column.values[place]
    values = np.where(np.abs(values) < LARGEST_NUMBER, values, math.nan)
    if may_wrap(column):
        values = signals.without_wraps(values, turn_of(column))
    every = slice(None, None, max(1, len(place) // signals.LOOKED_AT))
    return Series(column, clock, time_s[place][every], values[every])


def turn_of(column: Column) -> float | None:
    """A whole turn in the unit of an angle; None where that is not written."""
    unit = unit_of(column.unit)
    return TURN_RAD / unit.si if unit is not None and unit.dimension == "angle" else None


def may_wrap(column: Column) -> bool:
    """Whether a column can be an angle: by its unit, or else by what its name excludes."""
    dimension = written_dimension(column)
    if dimension in ("angle", ""):
        return dimension == "angle" or not (
            names.says(column.name, names.TORQUE) or names.says(column.name, names.OTHER)
        )
    return is_counted(column.unit)


@dataclass(frozen=True)
class UnitGuess:
    """A unit found for a column; None where it cannot be told."""

    unit: Unit | None
    why: str
    doubt: str = ""


def values_at(s: Series, other: Series) -> Array:
    """`other` at the times of `s`, NaN outside of its own."""
    if s.clock == other.clock and np.array_equal(s.time_s, other.time_s):
        return other.values
    known = np.isfinite(other.values)
    if not known.any():
        return np.full(len(s.values), math.nan)
    return np.interp(s.time_s, other.time_s[known], other.values[known], left=math.nan, right=math.nan)


def lag_of(leader: Series, follower: Series) -> float:
    """How far an angle comes after another; 0 on different clocks, where it is a question of the clocks."""
    if leader.clock != follower.clock:
        return 0.0
    every = max(1, len(leader.values) // 4000)
    after = values_at(leader, follower)
    if not np.isfinite(after).any():
        return 0.0
    return signals.lag_share(_smooth(leader.values)[::every], _smooth(after)[::every])


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


def repeats(one: Series, other: Series) -> bool:
    """Whether two columns on one clock hold one reading, as an encoder at the motor and over a gear."""
    if one.clock != other.clock:
        return False
    return signals.difference_share(one.time_s, one.values, other.time_s, other.values) < ROUNDING


def is_copy(base: Series, s: Series) -> bool:
    """Whether a column is the base's angle once more."""
    left = signals.difference_share(s.time_s, s.values, base.time_s, base.values)
    return left < COMMON and (s.clock != base.clock or names.is_base(s.column.name))
