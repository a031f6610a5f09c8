"""Units of angles and torque, from what is written and from what a needle does."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from needle_rig.dataset.description import RigPart, needle_of
from needle_rig.importing import signals
from needle_rig.importing.axes import SLIDING, SUMMED
from needle_rig.importing.guess.assignment import WRONG
from needle_rig.importing.guess.kinds import is_frequency, kind_of
from needle_rig.importing.guess.series import (
    Series,
    UnitGuess,
    from_start,
    span_ratio,
    torque_from_start,
    values_at,
    written_dimension,
)
from needle_rig.importing.mapping import ChannelPart
from needle_rig.importing.plausibility import LEAST_FOLLOWED, MOST_FOLLOWED, expected_torque_nm
from needle_rig.importing.unit_text import Unit, known_unit, unit_of
from needle_rig.numerics import Array
from needle_rig.physics.machine import Machine

TORQUE_UNITS = ("N·m", "N·cm", "N·mm", "µN·m")
"""Units in which torques of needles are written."""
UNIT_WITHIN = 5.0
"""Factor to the torque that is asked for beyond which a written unit is doubted; N·cm for N·mm makes ten."""
LEAST_TWIST_RAD = math.radians(2.0)
"""Below it the sensors' noise is the twist."""
FIRST_DEG = 5.0
"""Part of the base's first motion over which stiffness is taken, before much of the shaft slips."""
LARGEST_ROUND_DEG = 1800.0
"""Beyond it any level is within the tolerance of a round one."""
SMALLEST_DEG = 3.0
"""A base that turns less winds nothing up that a model could be held against."""
ROUND = 0.75
"""Share of levels at multiples of 5°; two of two at random are one in 150."""
LEAST_RADIANS = 0.6
"""A range without unit that is below it can be radians or turns: 34° or 216°."""


def base_unit(base: Series, sensors: Sequence[Series], machine: Machine) -> UnitGuess:
    """Unit of the base's angle: as written, or from its range, its speed and its round targets."""
    other = _of_another_axis(base)
    if other is not None:
        return other
    written = unit_of(base.column.unit)
    if written is None and base.column.unit:
        return UnitGuess(None, "", unknown_unit(base.column.unit, "deg"))
    if written is not None and written.dimension == "other":
        return UnitGuess(
            None, "", f"its unit is {base.column.unit}; write unit: turn and scale: 1/counts a turn"
        )
    known = np.isfinite(base.values)
    at = signals.levels(base.time_s[known], base.values[known])
    rate = signals.peak_rate(base.time_s, base.values)
    peak = float(np.nanmax(np.abs(from_start(base))))
    fitting, round_share = [], {}
    for text in ("deg", "rad", "turn"):
        degrees = math.degrees(known_unit(text).si)
        round_share[text] = signals.roundness(at * degrees) if peak * degrees <= LARGEST_ROUND_DEG else 0.0
        reach, turns = peak * degrees, rate * degrees
        if SMALLEST_DEG <= reach <= machine.largest_deg / 2 and turns <= machine.fastest_deg_s:
            fitting.append(text)
    rounds = [u for u in fitting if round_share[u] >= ROUND]
    # Turns are written as such, or are seen by their round degrees; as a range alone they are a radian's.
    if "turn" in fitting and "turn" not in rounds and peak > LEAST_RADIANS:
        fitting.remove("turn")
    if written is not None and written.dimension == "angle":
        degrees = math.degrees(written.si)
        others = (u for u in rounds if u != written.text)
        better = [u for u in others if signals.round_by_chance(at * math.degrees(known_unit(u).si)) < WRONG]
        if not (1.0 <= peak * degrees <= machine.largest_deg) or rate * degrees > machine.fastest_deg_s:
            likely = next(iter(rounds or fitting), None)
            return UnitGuess(
                written,
                f"unit {base.column.unit!r}",
                f"in {written.text}, as written, it reaches {peak * degrees:.4g}° at {rate * degrees:.3g}°/s"
                + (f"; {likely} would do" if likely else ""),
            )
        if better and signals.roundness(at * degrees) < 0.5:
            return UnitGuess(
                written,
                f"unit {base.column.unit!r}",
                f"it rests at multiples of 5° when read as {better[0]} and not as {written.text}, as written",
            )
        return UnitGuess(written, f"unit {base.column.unit!r}, up to {peak * degrees:.3g}°")
    ratios = [
        (unit_of(s.column.unit), span_ratio(base, s))
        for s in sensors
        if written_dimension(s.column) == "angle" and base.span
    ]
    for unit, ratio in ratios:
        assert unit is not None
        fit = [u for u in fitting if 0.1 < ratio * unit.si / known_unit(u).si < MOST_FOLLOWED]
        if len(fit) == 1:
            return UnitGuess(
                known_unit(fit[0]), f"the angles in {unit.text} follow it when it is in {fit[0]}"
            )
    if len(rounds) == 1 and (len(at) > 1 or len(fitting) == 1):
        degrees = math.degrees(known_unit(rounds[0]).si)
        return UnitGuess(
            known_unit(rounds[0]),
            f"it rests or turns at multiples of 5° when read as {rounds[0]}: {_told(at * degrees)}",
        )
    if len(fitting) == 1:
        reach = peak * math.degrees(known_unit(fitting[0]).si)
        return UnitGuess(
            known_unit(fitting[0]), f"its range: {reach:.3g}° as {fitting[0]}, no other unit would do"
        )
    if rounds:
        return UnitGuess(
            known_unit(rounds[0]), "", f"the unit is not written; {' or '.join(fitting)} would do"
        )
    if not fitting:
        return UnitGuess(
            None,
            "",
            f"the unit is not written, and up to {peak:.4g} it is none of deg, rad and turn; "
            "where it counts, write unit: turn and scale: 1/counts a turn",
        )
    return UnitGuess(None, "", f"the unit is not written; {' or '.join(fitting)} would do")


def _of_another_axis(s: Series) -> UnitGuess | None:
    """What is said of a speed, and of what slides; None for an angle."""
    written = unit_of(s.column.unit)
    if kind_of(s.column)[0] in SUMMED and is_frequency(s.column.unit):
        return UnitGuess(known_unit("turn/s"), "", "its unit is Hz: are these turns a second of the base?")
    if kind_of(s.column)[0] in SUMMED and written is None:
        return UnitGuess(None, "", "the unit of this speed is not written; write rad/s, deg/s or rpm")
    if written is None or written.dimension not in (*SUMMED, *SLIDING):
        return None
    ways = [f"unit {s.column.unit!r}"]
    ways += ["integrated over time"] if written.dimension in SUMMED else []
    ways += ["over the lever"] if written.dimension in SLIDING else []
    return UnitGuess(written, ", ".join(ways))


def unknown_unit(text: str, example: str) -> str:
    """What is asked of a unit that is written and not known."""
    return (
        f"its unit {text[:30]!r} is not known; write it as `unit`, as {example}, with `scale` where one of "
        "it is not one of that"
    )


def _told(degrees: Array) -> str:
    return ", ".join(f"{d:.3g}°" for d in degrees[:4])


def sensor_unit(s: Series, base_si: Array | None) -> UnitGuess:
    """Unit of an angle on the needle: as written, or from its share of the base's travel (rad)."""
    other = _of_another_axis(s)
    if other is not None:
        return other
    written = unit_of(s.column.unit)
    if base_si is None:
        angle = written if written is not None and written.dimension == "angle" else None
        if angle is None and s.column.unit:
            return UnitGuess(None, "", unknown_unit(s.column.unit, "deg"))
        return UnitGuess(
            angle, f"unit {s.column.unit!r}" if angle else "", "" if angle else "its unit is not known"
        )
    travel = float(np.nanmax(base_si) - np.nanmin(base_si))
    share = {u: s.span * known_unit(u).si / travel for u in ("deg", "rad", "turn")}
    fit = [u for u, part in share.items() if LEAST_FOLLOWED <= part <= MOST_FOLLOWED]
    if written is not None and written.dimension == "angle":
        part = s.span * written.si / travel
        if LEAST_FOLLOWED <= part <= MOST_FOLLOWED:
            return UnitGuess(written, f"unit {s.column.unit!r}, {part:.0%} of the base's motion")
        likely = fit[0] if fit else None
        return UnitGuess(
            written,
            f"unit {s.column.unit!r}",
            f"in {written.text}, as written, it turns {part:.3g} times as far as the base"
            + (f"; {likely} would do" if likely else ""),
        )
    if written is None and s.column.unit:
        return UnitGuess(None, "", unknown_unit(s.column.unit, "deg"))
    if written is not None:
        return UnitGuess(None, "", f"its unit is {s.column.unit}; write `unit` and `scale`")
    strong = [u for u in fit if share[u] > 0.1]
    if len(strong) == 1:
        return UnitGuess(known_unit(strong[0]), f"{share[strong[0]]:.0%} of the base's motion as {strong[0]}")
    taken = next(iter(strong or fit), None)
    return UnitGuess(
        known_unit(taken) if taken else None, "", "the unit is not written, and its motion does not tell it"
    )


def torque_unit(
    s: Series,
    base_si: Array | None,
    sensors: Sequence[Series],
    base: Series,
    channels: Sequence[ChannelPart],
    rig: RigPart | None,
) -> UnitGuess:
    """Unit of the torque: as written, or from what the twist up to the nearest sensor asks for."""
    written = unit_of(s.column.unit)
    if written is None and s.column.unit:
        return UnitGuess(None, "", unknown_unit(s.column.unit, "N·mm"))
    if written is not None and written.dimension == "force":
        return UnitGuess(written, f"unit {s.column.unit!r}, over the lever")
    if written is not None and written.dimension == "other":
        return UnitGuess(
            None, "", f"its unit is {s.column.unit}; write `unit` and `scale` of its calibration"
        )
    expected = _of_twist(base_si, sensors, base, channels, rig)
    if written is not None and written.dimension == "torque":
        why = f"unit {s.column.unit!r}"
        if expected is None:
            doubted = None
            if rig is not None and base_si is not None:
                doubted = _stiffness_unit(s, written, base, base_si, rig)
            return doubted or UnitGuess(written, why)
        torque_nm, how = expected
        ratio = s.span * written.si / torque_nm
        if 1 / UNIT_WITHIN < ratio < UNIT_WITHIN:
            return UnitGuess(written, f"{why}, {ratio:.2g} times what {how} asks for")
        fit = [u for u in TORQUE_UNITS if 1 / 3 < s.span * known_unit(u).si / torque_nm < 3]
        doubt = f"in {written.text}, as written, it spans {ratio:.3g} times what {how} asks for"
        return UnitGuess(written, why, doubt + (f"; {fit[0]} would do" if fit else ""))
    if expected is not None:
        torque_nm, how = expected
        # Neighbouring units are a factor ten apart, so no two of them fit.
        fit = [u for u in TORQUE_UNITS if 1 / 3 < s.span * known_unit(u).si / torque_nm < 3]
        if fit:
            return UnitGuess(known_unit(fit[0]), f"{how} asks for {torque_nm * 1e3:.2g} N·mm")
    return UnitGuess(None, "", "its unit is not written, and the recording cannot tell it; write `unit`")


def _stiffness_unit(s: Series, written: Unit, base: Series, base_si: Array, rig: RigPart) -> UnitGuess | None:
    """A doubt on a written unit when the torque first rises as no shaft of this length does, else None."""
    needle = needle_of(rig.needle)
    if not needle.rigidity_is_known:
        return None
    rigidity = needle.torsional_rigidity_nm2
    slope = signals.first_stiffness(base_si, torque_from_start(base, s), math.radians(FIRST_DEG))
    least, most = rigidity / (rig.needle_length_mm * 1e-3), math.inf
    if rig.tissue_sections_mm and rig.tissue_sections_mm[0][0] > 0:
        most = rigidity / (rig.tissue_sections_mm[0][0] * 1e-3)
    if slope == 0.0 or least / UNIT_WITHIN <= slope * written.si <= most * UNIT_WITHIN:
        return None
    fit = [u for u in TORQUE_UNITS if least / 2 < slope * known_unit(u).si < most * 2]
    return UnitGuess(
        written,
        f"unit {s.column.unit!r}",
        f"in {written.text}, as written, it first rises by {slope * written.si * 1e3:.2g} N·mm/rad where "
        f"the shaft has {least * 1e3:.2g} to {most * 1e3:.2g}" + (f"; {fit[0]} would do" if fit else ""),
    )


def _of_twist(
    base_si: Array | None,
    sensors: Sequence[Series],
    base: Series,
    channels: Sequence[ChannelPart],
    rig: RigPart | None,
) -> tuple[float, str] | None:
    """Span of the torque that the twist up to the nearest sensor asks for, N·m, and how it is known."""
    if rig is None or base_si is None or not needle_of(rig.needle).rigidity_is_known:
        return None
    places = {p.name: p.position_mm * 1e-3 for p in rig.hall_sensors if p.position_mm > 0}
    near = [c for c in channels if c.role in places and c.unit is not None]
    if not near:
        return None
    c = min(near, key=lambda c: places[c.role])
    s = next(x for x in sensors if x.clock == c.clock and x.column.name == c.source)
    unit = unit_of(c.unit or "")
    assert unit is not None
    rest = signals.rest_before_motion(base.values)
    lag = base_si - c.sign * unit.si * signals.from_rest(values_at(base, s), rest)
    lag = lag[np.isfinite(lag)]
    twist = float(np.ptp(lag)) if len(lag) else 0.0
    if twist < LEAST_TWIST_RAD:
        return None
    rigidity = needle_of(rig.needle).torsional_rigidity_nm2
    return expected_torque_nm(twist, places[c.role], rigidity), f"the twist up to {c.role}"
