"""Which column is the base's angle, which the torque, which the sensors on the needle, in their order."""

from __future__ import annotations

from collections.abc import Sequence

from needle_rig.dataset.description import RigPart
from needle_rig.importing import names, signals
from needle_rig.importing.guess.series import (
    Series,
    from_start,
    is_copy,
    lag_of,
    span_ratio,
    torque_from_start,
    values_at,
    written_dimension,
)
from needle_rig.importing.recording import Column
from needle_rig.importing.signals import CLEAR_LAG
from needle_rig.importing.unit_text import is_counted


def kind_of(column: Column) -> tuple[str, str]:
    """Kind of a column: angle, torque, other, or empty where neither name nor unit says it; and the reason.

    A torque or an angle by name whose unit is not known stays one: its unit is asked.
    """
    dimension, name, unit = written_dimension(column), column.name, column.unit
    if names.says(name, names.COMMAND):
        return "other", "called what was commanded, and what was measured is asked for"
    if dimension in ("angle", "torque"):
        return dimension, f"unit {unit!r}"
    torque = names.says(name, names.TORQUE)
    angle = any(names.says(name, p) for p in (names.ANGLE, names.BASE, names.SENSOR))
    if dimension and not is_counted(unit):
        return "other", f"its unit {unit} is neither one of an angle nor of a torque"
    if torque:
        return "torque", "name"
    if names.says(name, names.OTHER):
        return "other", "called what is neither an angle nor a torque"
    if angle:
        return "angle", "name"
    if dimension:
        return "other", f"it counts {unit}, and its name does not say of what"
    if unit:
        return "other", f"its unit {unit!r} is not known, and its name says neither angle nor torque"
    return "", "neither its name nor its unit says what it is"


TOGETHER = 0.85
"""Correlation above which a column without name and unit moves as an angle does; a torque relaxes."""


def base_among(angles: Sequence[Series], unnamed: Sequence[Series]) -> tuple[Series, str, str]:
    """The base among the angles: by name, and by what comes first. Why, and what speaks against it."""
    named: list[Series] = []
    for s in sorted(angles, key=lambda s: -len(s.column.values)):
        if names.is_base(s.column.name) and not any(
            is_copy(kept, s) for kept in named if kept.clock != s.clock
        ):
            named.append(s)
    leads = sorted(angles, key=lambda s: _leads(s, angles), reverse=True)
    first = leads[0]
    others = [s for s in angles if s is not first]
    clear = bool(others) and all(lag_of(first, s) > CLEAR_LAG for s in others)
    if len(named) == 1 or (named and first not in named):
        base = named[0]
        late = [s.column.name for s in angles if s is not base and lag_of(base, s) < -CLEAR_LAG]
        doubt = (
            f"{late[0]} moves before it, which no needle does; are the columns or the clocks swapped?"
            if late
            else ""
        )
        lagging = sum(1 for s in angles if s is not base and lag_of(base, s) > CLEAR_LAG)
        extra = f"; {lagging} of {len(angles) - 1} other angles come after it" if lagging else ""
        return base, f"name{extra}", doubt
    if len(named) > 1:
        same = [
            s
            for s in named
            if s is not first and abs(lag_of(first, s)) < CLEAR_LAG and span_ratio(first, s) > 0.98
        ]
        doubt = (
            ""
            if first in named and (clear or len(angles) > len(named)) and not same
            else (
                f"{', '.join(s.column.name for s in named)} could each be the base; keep what is mounted at "
                "it"
            )
        )
        return first, "name; all other angles come after it" if clear else "name", doubt
    if len(angles) == 1 and not unnamed and names.says(first.column.name, names.SENSOR):
        return (
            first,
            "the only angle",
            "its name is that of a sensor on the needle; is it the base's encoder?",
        )
    before = [s for s in unnamed if follows(first, s) and lag_of(first, s) < CLEAR_LAG]
    if before:
        other = max(before, key=lambda s: _leads(s, angles))
        together = abs(signals.follow_sign(first.values, values_at(first, other)))
        if together > TOGETHER and all(lag_of(other, s) > CLEAR_LAG for s in angles):
            return other, "all angles come after it", "neither its name nor its unit says that it is an angle"
        told = ", ".join(s.column.name for s in before)
        return first, "the first of what is an angle", f"{told} moves with it and could be the base as well"
    if len(angles) == 1 and written_dimension(first.column) == "angle":
        return first, "the only angle", ""
    if clear:
        plain = all(
            written_dimension(s.column) == "angle" or names.says(s.column.name, names.ANGLE) for s in angles
        )
        return first, "all other angles come after it", "" if plain else "no name says so"
    if all(names.says(s.column.name, names.SENSOR) for s in others) and not names.says(
        first.column.name, names.SENSOR
    ):
        return first, "the only angle that is not called a sensor's", ""
    return first, "the widest motion", "no name says so, and none of the angles clearly comes first"


def _leads(s: Series, angles: Sequence[Series]) -> float:
    lags = [lag_of(s, other) for other in angles if other is not s]
    return min(lags) if lags else 0.0


def follows(base: Series, s: Series) -> bool:
    """Whether an angle moves with the base, either way round, as one on the needle does."""
    return abs(signals.follow_sign(base.values, values_at(base, s))) > 0.3


def split_unnamed(
    base: Series, rest: Sequence[Series], torques: list[Series]
) -> tuple[list[Series], list[Series]]:
    """Columns without name and unit: a torque is what relaxes and reverses while angles stay."""
    angles: list[Series] = []
    for s in rest:
        follows = abs(signals.follow_sign(base.values, values_at(base, s)))
        (angles if follows > TOGETHER else torques).append(s)
    return angles, torques


def sensor_roles(
    sensors: list[Series], base: Series, rig: RigPart | None
) -> list[tuple[str | None, str, str]]:
    """Role, reason and doubt of each angle on the needle; no role for one that the layout has no sensor for.

    Puts `sensors` in the order along the shaft that their names say, or else their lag behind the base.
    """
    numbered = all(names.numbers_in(s.column.name) for s in sensors)
    by_lag = sorted(sensors, key=lambda s: lag_of(base, s))
    if numbered:
        sensors.sort(key=lambda s: (names.numbers_in(s.column.name), s.column.name))
    elif len(sensors) > 1:
        sensors[:] = by_lag
    against = numbered and any(
        lag_of(sensors[k + 1], sensors[k]) > CLEAR_LAG and sensors[k].clock == sensors[k + 1].clock
        for k in range(len(sensors) - 1)
    )
    order = "number in its name" if numbered else "its lag behind the base"
    if len(sensors) == 1:
        order = "the only angle on the needle"
    doubt = (
        "the sensors' numbers do not run from the base to the tip: what has the higher number moves first"
        if against
        else ""
    )
    if rig is None:
        return [(f"angle_{k + 1}", order, doubt) for k in range(len(sensors))]
    known = [s.name for s in sorted(rig.hall_sensors, key=lambda p: p.position_mm)]
    same = {s.column.name: n for s in sensors for n in known if names.plain(s.column.name) == names.plain(n)}
    if len(same) == len(sensors):
        return [(same[s.column.name], "name", doubt) for s in sensors]
    if len(sensors) == len(known):
        return [(n, order, doubt) for n in known]
    if not known:
        return [(None, "", "") for _ in sensors]
    few = f"the layout has {len(known)} sensors, the recording {len(sensors)} angles; say which is which"
    return [(known[k] if k < len(known) else None, order, few) for k in range(len(sensors))]


def torque_among(base: Series, torques: Sequence[Series], named: bool) -> Series | None:
    """The base's torque among several: by name, by the work it does, or (`named` false) by its span."""
    if not torques:
        return None
    if len(torques) == 1:
        return torques[0]
    best = [s for s in torques if names.says(s.column.name, names.BASE)]
    if len(best) == 1:
        return best[0]
    return max(
        torques,
        key=lambda s: (
            abs(signals.work_share(from_start(base), torque_from_start(base, s))) if named else s.span
        ),
    )
