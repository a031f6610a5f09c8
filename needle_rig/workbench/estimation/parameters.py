"""Effects as points that a fit can move: off is 0 and the typical size is 1, whatever the unit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, ParameterInfo
from needle_rig.physics.rod import Layout

WIDE = 10.0
"""Prior standard deviation of a strength whose effect's file states none: ten typical sizes."""
FORM_DECADES = 1.0
FAR = 1e3


@dataclass(frozen=True)
class Coordinate:
    """One number of one effect."""

    effect: str
    field: str
    item: int | None
    info: ParameterInfo

    @property
    def name(self) -> str:
        """The parameter's name within its effect."""
        return self.field if self.item is None else f"{self.field}[{self.item}]"

    @cached_property
    def _axis(self) -> tuple[float, float, bool]:
        """(zero, length, on the declared scale) of the axis."""
        info = self.info
        scaled = (
            info.scale != "log" or (info.shapes and info.typical > 0) or (info.off > 0 and info.typical > 0)
        )
        typical = info.to_scale(info.typical) if scaled else info.typical
        if info.shapes:
            length = math.log(10.0) if scaled and info.scale == "log" else abs(typical) or 1.0
            return typical, length, scaled
        off = info.to_scale(info.off) if scaled else info.off
        return off, typical - off, scaled

    def position(self, value: float) -> float:
        """Where `value` (in the field's unit) lies on the axis."""
        zero, length, scaled = self._axis
        return float(((self.info.to_scale(value) if scaled else value) - zero) / length)

    def value(self, position: float) -> float:
        """The field's value at `position`, within its bounds or exactly off."""
        zero, length, scaled = self._axis
        if position == 0.0 and not self.info.shapes:
            return self.info.off
        raw = zero + length * position
        value = self.info.from_scale(raw) if scaled else raw
        low, high = self.info.lower, self.info.upper
        if low <= value <= high:
            return float(value)
        nearest = low if value < low else high
        if not self.info.shapes and abs(position) < 0.5 * abs(self.position(nearest)):
            return self.info.off
        return float(nearest)

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest position."""
        _, length, scaled = self._axis
        ends = []
        for value in (self.info.lower, self.info.upper):
            if value == 0 and scaled and self.info.scale != "linear":
                # 1/0 and log 0: as far as it goes, to the side on which it lies
                ends.append(math.copysign(FAR, length if self.info.scale == "reciprocal" else -length))
            else:
                ends.append(max(-FAR, min(FAR, self.position(value))))
        low, high = min(ends), max(ends)
        return (low, high) if self.info.shapes else (min(low, 0.0), max(high, 0.0))

    @property
    def one_sided(self) -> bool:
        """Whether off lies at the edge of what is possible."""
        low, high = self.bounds
        return not self.info.shapes and not (low < 0.0 < high)

    @cached_property
    def smallest(self) -> float:
        """Position below which the size does not matter."""
        return 0.0 if self.info.shapes else abs(self.position(self.info.smallest))

    @property
    def width(self) -> float:
        """Prior standard deviation on the axis."""
        if self.info.shapes:
            return FORM_DECADES
        if self.info.prior is None:
            return WIDE
        size = (
            abs(self.info.off) if math.isfinite(self.info.off) and self.info.off else abs(self.info.typical)
        )
        return max(abs(self.position(self.info.off + self.info.prior * size)), 1e-6)


def coordinates(
    effects: Mapping[str, type[Effect]], names: Sequence[str], layout: Layout
) -> tuple[Coordinate, ...]:
    """The coordinates of the named effects, in that order."""
    counts = {"sensor": len(layout.sensor_positions_m), "section": len(layout.tissue_sections_m)}
    found = []
    for name in names:
        for field, info in effects[name].parameters().items():
            items = [None] if info.per == "one" else list(range(counts[info.per]))
            found += [Coordinate(name, field, item, info) for item in items]
    return tuple(found)


def held_means(axes: Sequence[Coordinate]) -> list[Array]:
    """Places of the items that count against their mean, an array for each such field."""
    fields: dict[tuple[str, str], list[int]] = {}
    for place, axis in enumerate(axes):
        if axis.info.relative:
            fields.setdefault((axis.effect, axis.field), []).append(place)
    return [np.array(places) for places in fields.values()]


def against_mean(axes: Sequence[Coordinate], positions: Array) -> Array:
    """The same effects with items that count against their mean put so that it is off."""
    moved = positions.copy()
    for places in held_means(axes):
        values = np.array([axes[i].value(float(positions[i])) for i in places])
        if values.mean() > 0.0:
            share = axes[places[0]].info.off / values.mean()
            moved[places] = [axes[i].position(float(v * share)) for i, v in zip(places, values, strict=True)]
    return moved


def make_effects(
    effects: Mapping[str, type[Effect]], axes: Sequence[Coordinate], positions: Array
) -> tuple[Effect, ...]:
    """Effects with the values at `positions`, one for each coordinate."""
    fields: dict[str, dict[str, float | list[float]]] = {}
    for axis, position in zip(axes, positions, strict=True):
        value = axis.value(float(position))
        own = fields.setdefault(axis.effect, {})
        if axis.item is None:
            own[axis.field] = value
        else:
            own.setdefault(axis.field, [])
            own[axis.field].append(value)  # type: ignore[union-attr]
    return tuple(
        effects[name](**{k: tuple(v) if isinstance(v, list) else v for k, v in own.items()})
        for name, own in fields.items()
    )


def positions_of(axes: Sequence[Coordinate], effects: Sequence[Effect]) -> Array:
    """Positions of given effects on `axes`; coordinates of effects not given stand at off."""
    by_name = {e.name(): e for e in effects}
    found = np.zeros(len(axes))
    for i, axis in enumerate(axes):
        effect = by_name.get(axis.effect)
        if effect is not None:
            value = np.atleast_1d(np.asarray(getattr(effect, axis.field), dtype=float))
            one = value[axis.item if axis.item is not None and value.size > 1 else 0]
            found[i] = 0.0 if one == axis.info.off and not axis.info.shapes else axis.position(float(one))
    return found
