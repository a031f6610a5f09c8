"""What names and units say of columns, and the order of the sensors along the shaft."""

from __future__ import annotations

from needle_rig.dataset.description import RigPart
from needle_rig.importing import names
from needle_rig.importing.axes import OF_ANGLE, OF_TORQUE
from needle_rig.importing.guess.series import Series, lag_of, written_dimension
from needle_rig.importing.recording import Column
from needle_rig.importing.signals import CLEAR_LAG
from needle_rig.importing.unit_text import is_counted

AMPERES = frozenset({"a", "ma", "amp", "amps"})


def is_frequency(text: str) -> bool:
    """Whether a unit is hertz: of a speed by name these are turns a second."""
    return text.strip().lower() == "hz"


def kind_of(column: Column) -> tuple[str, str]:
    """Kind of a column: what it measures, other, or empty where neither name nor unit says it; with reason.

    It is unclear where the name says nothing and the unit is not known. Kinds are the dimensions of units. A
    torque or an angle by name whose unit is not known stays one: its unit is asked.
    """
    dimension, name, unit = written_dimension(column), column.name, column.unit
    if names.says(name, names.COMMAND):
        return "other", "called what was commanded, and what was measured is asked for"
    if dimension in ("angle", "torque"):
        return dimension, f"unit {unit!r}"
    if dimension in (*OF_ANGLE, *OF_TORQUE):
        return dimension, f"its unit {unit} is that of a {dimension}, and other columns tell angle and torque"
    torque = names.says(name, names.TORQUE)
    angle = any(names.says(name, p) for p in (names.ANGLE, names.BASE, names.SENSOR))
    if names.says(name, names.RATE) and (not unit or is_frequency(unit)):
        return "rate", "called a speed, and other columns tell the angle"
    if names.says(name, names.CURRENT) or unit.lower() in AMPERES:
        return "current", "a current, and other columns tell the torque"
    if dimension and not is_counted(unit):
        return "other", f"its unit {unit} is neither one of an angle nor of a torque"
    if torque:
        return "torque", "name"
    if names.says(name, names.FORCE):
        return "force", "called a force, and other columns tell angle and torque"
    if names.says(name, names.OTHER):
        return "other", "called what is neither an angle nor a torque"
    if angle:
        return "angle", "name"
    if dimension:
        return "other", f"it counts {unit}, and its name does not say of what"
    if unit:
        return "unclear", f"its unit {unit!r} is not known, and its name says neither angle nor torque"
    return "", "neither its name nor its unit says what it is"


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
