"""The channels of a mapping: role, unit and sign of each, with its reason and its doubt."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from needle_rig.config.places import show_path
from needle_rig.dataset.description import RigPart
from needle_rig.errors import BadInput
from needle_rig.importing import names, signals
from needle_rig.importing.axes import OF_ANGLE, OF_TORQUE, SUMMED, size_si, summed
from needle_rig.importing.guess.assignment import CLEAR, Choice, assign
from needle_rig.importing.guess.generic_shaft import Driver
from needle_rig.importing.guess.kinds import kind_of, sensor_roles
from needle_rig.importing.guess.known import Known
from needle_rig.importing.guess.series import (
    FEWEST,
    Series,
    from_start,
    is_copy,
    repeats,
    torque_from_start,
    values_at,
    written_dimension,
)
from needle_rig.importing.guess.units import base_unit, sensor_unit, torque_unit
from needle_rig.importing.mapping import BASE, TIP_TORQUE, TORQUE, ChannelPart
from needle_rig.importing.recording import Column, Recording
from needle_rig.importing.signals import CLEAR_WORK
from needle_rig.importing.unit_text import unit_of
from needle_rig.numerics import Array

SLIDES = ("length", "speed")
Reasons = dict[tuple[str, str], str]
"""By clock and name of a column."""
WEAK = 0.4
"""Correlation of an angle with the base below which its sign is asked; noise has some 1/√samples."""


def channels_of(
    series: Sequence[Series], known: Known, recordings: Sequence[Recording], left: Reasons
) -> tuple[list[ChannelPart], Reasons]:
    """The channels of all series, and for each series why it is none, should it be none.

    `known` is what a person said of the machine, `left` the reasons of columns that are no series, for an
    error.

    Raises BadInput when there is nothing that could be the base's angle.
    """
    of_kind: defaultdict[str, list[Series]] = defaultdict(list)
    rig, why = known.rig, Reasons()
    for s in series:
        kind, reason = kind_of(s.column)
        count = int(np.isfinite(s.values).sum())
        if count < FEWEST:
            kind, reason = "other", f"{count} numbers at known times, fewer than {FEWEST}"
        elif s.span == 0.0:
            kind, reason = "other", "never changes"
        of_kind[kind].append(s)
        why[key_of(s)] = reason
    unnamed = of_kind[""]
    angles, torques = _axes(of_kind, known)
    if not angles and not unnamed:
        told = "; ".join(f"{name}: {reason}" for (_, name), reason in {**why, **left}.items())
        raise BadInput(
            f"{', '.join(show_path(r.path) for r in recordings)}: no column can be the base's angle "
            f"({told[:600]}); record the angle of what turns the base beside them"
        )
    if not torques and known.needs_torque:
        torques = of_kind["current"]
    found = assign(angles, torques, unnamed, known.needs_torque)
    base, torque = found.base.series, found.torque
    sensors = []
    once_more = _repeated(base, found.followers)
    expected = {names.plain(sensor.name) for sensor in (rig.hall_sensors if rig else ())}
    for s in [*angles, *unnamed]:
        if s is base or (torque is not None and s is torque.series):
            continue
        first = base if is_copy(base, s) else once_more.get(key_of(s))
        if first is not None:
            why[key_of(s)] = f"{first.column.name} once more"
        elif known.needs_torque and not kind_of(s.column)[0] and names.plain(s.column.name) not in expected:
            why[key_of(s)] += ", and no angle beyond the base is needed"
        elif any(s is f for f in found.followers) or names.plain(s.column.name) in expected:
            # one that the layout names is asked, not dropped
            sensors.append(s)
        else:
            together = signals.follow_sign(base.values, values_at(base, s))
            why[key_of(s)] = f"does not move with {base.column.name} (correlation {together:.2f})"
    unit = base_unit(base, sensors, known.machine)
    channels = [
        ChannelPart(
            role=BASE,
            clock=base.clock,
            source=base.column.name,
            unit=None if unit.unit is None else unit.unit.text,
            zero=_zero(base),
            why="; ".join(filter(None, (found.base.told, unit.why))),
            doubt="; ".join(filter(None, (found.base.doubt, _against_its_name(base), unit.doubt))),
        )
    ]
    roles = sensor_roles(sensors, base, rig)
    base_si = None if unit.unit is None else from_start(base) * size_si(unit.unit, known.lever_mm)
    if base_si is not None and not np.isfinite(base_si).any():
        base_si = None
    for s, (role, said, doubt) in zip(sensors, roles, strict=True):
        if role is not None:
            channels.append(_sensor(s, role, base, base_si, said, doubt))
        else:
            why[key_of(s)] = "the layout has no sensor for it"
    if torque is not None:
        rest = [s for s in torques if s is not torque.series]
        for s in rest:
            why[key_of(s)] = f"a torque, and {torque.series.column.name} is taken for that of the base"
        channels.append(_torque_channel(torque, base, base_si, sensors, channels, known))
        at_tip = [s for s in rest if names.says(s.column.name, names.TIP)]
        if len(at_tip) == 1:
            channels.append(_tip_torque_channel(at_tip[0]))
    return channels, why


def asked_lost(
    channels: Sequence[ChannelPart],
    faulty: Sequence[Column],
    series: Sequence[Series],
    rig: RigPart | None,
) -> list[ChannelPart]:
    """The channels; their base is asked about columns that may have held what is not there.

    That is a torque, or an angle that the layout of `rig` has a sensor for. Columns that may have held it are
    `faulty` ones, and those of an unclear kind that a generic shaft explains as its torque.
    """
    roles = {c.role for c in channels}
    doubts = []
    if TORQUE not in roles:
        lost = [f"{c.name} {c.fault}" for c in faulty if kind_of(c)[0] in ("torque", "")]
        unclear = [s for s in series if kind_of(s.column)[0] == "unclear"]
        if unclear:
            at = next((c.clock, c.source) for c in channels if c.role == BASE)
            driver = Driver(next(s for s in series if key_of(s) == at))
            moves = [s.column for s in unclear if driver.gain(s, torque=True) > CLEAR]
            lost += [f"{column.name} moves as one would: {kind_of(column)[1]}" for column in moves]
        if lost:
            doubts.append(f"no torque goes with it, and {'; '.join(dict.fromkeys(lost))[:300]}")
    if missing := [sensor.name for sensor in (rig.hall_sensors if rig else ()) if sensor.name not in roles]:
        lost = [f"{c.name} {c.fault}" for c in faulty if kind_of(c)[0] in ("angle", "")]
        if lost:
            doubts.append(f"{', '.join(missing)} is not there, and {'; '.join(dict.fromkeys(lost))[:300]}")
    if not doubts:
        return list(channels)
    doubt = f"{'; '.join(doubts)}; shall it be imported without?"
    return [
        c if c.role != BASE else c.model_copy(update={"doubt": "; ".join(filter(None, (c.doubt, doubt)))})
        for c in channels
    ]


def _repeated(base: Series, followers: Sequence[Series]) -> dict[tuple[str, str], Series]:
    """By follower what it holds once more; of two the one that turns as far as the base is kept.

    What is named as a sensor on the needle is one, however exactly it follows.
    """
    kept: list[Series] = [base]
    repeated = {}
    unnamed = [s for s in followers if not names.says(s.column.name, names.SENSOR)]
    for s in sorted(unnamed, key=lambda s: abs(math.log(max(_turns(s), 1e-300) / _turns(base)))):
        first = next((k for k in kept if repeats(k, s)), None)
        if first is None:
            kept.append(s)
        else:
            repeated[key_of(s)] = first
    return repeated


def _turns(s: Series) -> float:
    """Its span in SI, or as it is where the unit is not known."""
    unit = unit_of(s.column.unit)
    return s.span * (unit.si if unit is not None and unit.dimension in OF_ANGLE else 1.0)


def _axes(of_kind: Mapping[str, list[Series]], known: Known) -> tuple[list[Series], list[Series]]:
    """What turns, or else what becomes a turn, and the torques or else the forces; speeds are summed up."""
    slides = known.slides
    for kind in (*(SLIDES if slides else ()), "angle", "rate", *(() if of_kind.get("") else SLIDES)):
        moving = of_kind.get(kind, [])
        if moving:
            break
    else:
        return [], of_kind.get("torque", [])
    if kind in SUMMED:
        moving = [replace(s, values=summed(s.time_s, s.values)) for s in moving]
    torques, forces = of_kind.get("torque", []), of_kind.get("force", [])
    if kind in SLIDES or (known.lever_mm is not None and not torques):
        return moving, forces or torques
    return moving, torques


def _zero(s: Series) -> float | Literal["start"]:
    """What a channel counts from: its start, but for a speed, which no start tells."""
    return 0.0 if kind_of(s.column)[0] in SUMMED else "start"


def _against_its_name(base: Series) -> str:
    """What is asked of a base whose name and unit do not say that it is one."""
    name = base.column.name
    if kind_of(base.column)[0] not in OF_ANGLE:
        return "neither its name nor its unit says that it is an angle"
    if names.says(name, names.SENSOR) and not names.is_base(name):
        return "its name is that of a sensor on the needle; is it the base's encoder?"
    return ""


def key_of(s: Series) -> tuple[str, str]:
    """Clock and name, which tell a column from all others."""
    return s.clock, s.column.name


def _sensor(s: Series, role: str, base: Series, base_si: Array | None, why: str, doubt: str) -> ChannelPart:
    values = values_at(base, s)
    follow = signals.follow_sign(base.values, values)
    sign: Literal[1, -1] = 1 if follow >= 0 else -1
    unit = sensor_unit(s, base_si)
    turned = "" if sign > 0 else "it falls while the base rises"
    weak = f"it follows the base weakly (correlation {follow:.2f})" if abs(follow) < WEAK else ""
    if sign > 0 and not weak:
        turned = "it turns with the base"
    return ChannelPart(
        role=role,
        clock=s.clock,
        source=s.column.name,
        unit=None if unit.unit is None else unit.unit.text,
        sign=sign,
        zero=_zero(s),
        why="; ".join(filter(None, (why, unit.why, turned))),
        doubt="; ".join(filter(None, (doubt, unit.doubt, weak))),
    )


def _tip_torque_channel(s: Series) -> ChannelPart:
    written = unit_of(s.column.unit) if written_dimension(s.column) == "torque" else None
    return ChannelPart(
        role=TIP_TORQUE,
        clock=s.clock,
        source=s.column.name,
        unit=None if written is None else written.text,
        why="a second torque, called as at the tip",
        doubt="does it push the needle there, positive counter-clockwise seen from the base? It becomes an"
        " input of the model; remove the line where the tip is free",
    )


def _torque_channel(
    choice: Choice,
    base: Series,
    base_si: Array | None,
    sensors: Sequence[Series],
    channels: Sequence[ChannelPart],
    known: Known,
) -> ChannelPart:
    s = choice.series
    counted = values_at(base, s) if known.torque_zero == 0.0 else torque_from_start(base, s)
    work = signals.work_share(from_start(base), counted)
    doubts = []
    shared = int((np.isfinite(base.values) & np.isfinite(values_at(base, s))).sum())
    if shared < FEWEST:
        doubts.append(f"{shared} samples have it beside {base.column.name}; say its sign")
    elif abs(work) < CLEAR_WORK:
        doubts.append(
            f"torque and angle agree in sign for {50 + 50 * work:.0f} % of the work; check the sign"
        )
    named = names.says(s.column.name, names.TORQUE) or kind_of(s.column)[0] in OF_TORQUE
    if kind_of(s.column)[0] == "current":
        doubts.append(
            "a current stands for the torque; write unit: N·m, and scale: the motor's constant in N·m/A"
        )
    elif not named:
        doubts.append("neither name nor unit says that it is a torque")
    if choice.doubt:
        doubts.append(choice.doubt)
    unit = torque_unit(s, base_si, sensors, base, channels, known.rig)
    if unit.doubt:
        doubts.append(unit.doubt)
    agreed = (
        f"it rises while the base winds up ({abs(work):.0%} of the work)"
        if work > 0
        else (f"it falls while the base winds up ({abs(work):.0%} of the work), so its sign is turned")
    )
    return ChannelPart(
        role=TORQUE,
        clock=s.clock,
        source=s.column.name,
        unit=None if unit.unit is None else unit.unit.text,
        sign=1 if work >= 0 else -1,
        zero=known.torque_zero,
        why="; ".join(filter(None, (choice.told, unit.why, agreed))),
        doubt="; ".join(doubts),
    )
