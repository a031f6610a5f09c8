"""The channels of a mapping: role, unit and sign of each, with its reason and its doubt."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from needle_rig.config.places import show_path
from needle_rig.dataset.description import RigPart
from needle_rig.errors import BadInput
from needle_rig.importing import names, signals
from needle_rig.importing.guess.roles import (
    base_among,
    follows,
    kind_of,
    sensor_roles,
    split_unnamed,
    torque_among,
)
from needle_rig.importing.guess.series import (
    Series,
    from_start,
    is_copy,
    torque_from_start,
    values_at,
    written_dimension,
)
from needle_rig.importing.guess.units import base_unit, sensor_unit, torque_unit
from needle_rig.importing.mapping import BASE, TIP_TORQUE, TORQUE, ChannelPart
from needle_rig.importing.recording import Recording
from needle_rig.importing.signals import CLEAR_WORK
from needle_rig.importing.unit_text import unit_of
from needle_rig.numerics import Array

WEAK = 0.4
"""Correlation of an angle with the base below which its sign is asked; noise has some 1/√samples."""


def channels_of(
    series: Sequence[Series], rig: RigPart | None, recordings: Sequence[Recording]
) -> tuple[list[ChannelPart], list[str]]:
    """The channels of all series, and the names of columns that do not change.

    Raises BadInput when there is nothing that could be the base's angle.
    """
    changing = [s for s in series if s.span > 0.0 and np.isfinite(s.values).sum() >= 10]
    constant = [s.column.name for s in series if s not in changing]
    angles: list[Series] = []
    torques: list[Series] = []
    unnamed: list[Series] = []
    for s in changing:
        kind = kind_of(s)
        (
            angles if kind == "angle" else torques if kind == "torque" else unnamed if kind == "" else []
        ).append(s)
    if not angles and not unnamed:
        raise BadInput(
            f"{', '.join(show_path(r.path) for r in recordings)}: no column can be the base's angle "
            f"(columns: {', '.join(s.column.name for s in series)[:300]}); write a mapping by hand"
        )
    base, base_why, base_doubt = base_among(angles or unnamed, unnamed if angles else [])
    rest = [s for s in (angles or unnamed) if s is not base]
    if not angles:
        rest, torques = split_unnamed(base, rest, torques)
    sensors = [s for s in rest if follows(base, s) and not is_copy(base, s)]
    unit = base_unit(base, sensors)
    channels = [
        ChannelPart(
            role=BASE,
            clock=base.clock,
            source=base.column.name,
            unit=None if unit.unit is None else unit.unit.text,
            zero="start",
            why="; ".join(filter(None, (base_why, unit.why))),
            doubt="; ".join(filter(None, (base_doubt, unit.doubt))),
        )
    ]
    roles = sensor_roles(sensors, base, rig)
    base_si = None if unit.unit is None else from_start(base) * unit.unit.si
    for s, (role, why, doubt) in zip(sensors, roles, strict=True):
        if role is not None:
            channels.append(_sensor(s, role, base, base_si, why, doubt))
    torque = torque_among(base, torques or ([] if angles else unnamed), bool(torques))
    if torque is not None and torque not in sensors:
        channels.append(_torque_channel(torque, torques, base, base_si, sensors, channels, rig))
        at_tip = [s for s in torques if s is not torque and names.says(s.column.name, names.TIP)]
        if len(at_tip) == 1:
            channels.append(_tip_torque_channel(at_tip[0]))
    return channels, constant


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
        zero="start",
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
    s: Series,
    torques: Sequence[Series],
    base: Series,
    base_si: Array | None,
    sensors: Sequence[Series],
    channels: Sequence[ChannelPart],
    rig: RigPart | None,
) -> ChannelPart:
    work = signals.work_share(from_start(base), torque_from_start(base, s))
    doubts = []
    if abs(work) < CLEAR_WORK:
        doubts.append(
            f"torque and angle agree in sign for {50 + 50 * work:.0f} % of the work; check the sign"
        )
    named = names.says(s.column.name, names.TORQUE) or written_dimension(s.column) == "torque"
    if not named:
        doubts.append("neither name nor unit says that it is a torque")
    if len(torques) > 1 and not names.says(s.column.name, names.BASE):
        rest = ", ".join(o.column.name for o in torques if o is not s)
        doubts.append(f"{rest} could be it as well")
    unit = torque_unit(s, base_si, sensors, base, channels, rig)
    if unit.doubt:
        doubts.append(unit.doubt)
    way = "it rises" if work > 0 else "it falls, so its sign is turned:"
    agreed = (
        f"{way} while the base winds up ({abs(work):.0%} of the work)"
        if work > 0
        else (f"it falls while the base winds up ({abs(work):.0%} of the work), so its sign is turned")
    )
    return ChannelPart(
        role=TORQUE,
        clock=s.clock,
        source=s.column.name,
        unit=None if unit.unit is None else unit.unit.text,
        sign=1 if work >= 0 else -1,
        zero="start",
        why="; ".join(filter(None, ("name" if named else "", unit.why, agreed))),
        doubt="; ".join(doubts),
    )
