"""Channels from what a file holds to radians and N·m."""

from __future__ import annotations

import numpy as np

from needle_rig.importing import signals
from needle_rig.importing.axes import SUMMED, size_si
from needle_rig.importing.mapping import BASE, TIP_TORQUE, TORQUE, ChannelPart
from needle_rig.importing.unit_text import unit_of
from needle_rig.numerics import Array


def to_si(
    values: Array, parts: dict[str, ChannelPart], sensors: tuple[str, ...], lever_mm: float | None
) -> None:
    """Columns of the table from what the file holds, speeds summed up, to radians and N·m, in place."""
    rest = signals.rest_before_motion(values[:, 1])
    for k, role in enumerate((BASE, TORQUE, *sensors, TIP_TORQUE), start=1):
        part = parts.get(role)
        if part is None:
            continue
        unit = unit_of(part.unit or "")
        assert unit is not None
        zero = 0.0 if unit.dimension in SUMMED else part.zero
        if zero == "start":
            begin = values[:rest, k]
            if not np.isfinite(begin).any():
                begin = values[np.isfinite(values[:, k]), k][:1]
            known = begin[np.isfinite(begin)]
            zero = float(known.mean()) if len(known) else 0.0
        values[:, k] = part.sign * part.scale * size_si(unit, lever_mm) * (values[:, k] - zero)
