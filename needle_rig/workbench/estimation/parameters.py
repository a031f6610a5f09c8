"""Free parameters of effects, scaled: off is 0 and the typical size is 1, whatever the unit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, ParameterInfo
from needle_rig.physics.needle_model import FRICTION, TORSIONAL_RIGIDITY
from needle_rig.physics.rod import Layout

WIDE = 10.0
"""Prior standard deviation of a strength whose effect's file states none: ten typical sizes."""
FORM_DECADES = 1.0
"""Prior standard deviation of a form parameter, in its scale: a decade."""
FAR = 1e3
"""Largest scaled value: what has no bound is bounded here."""


@dataclass(frozen=True)
class FreeParameter:
    """One number of one effect that a fit moves."""

    effect: str
    field: str
    item: int | None
    info: ParameterInfo
    places: tuple[tuple[float, ...], ...] = ()
    """Values to try of what a fit holds (`ParameterInfo.places`), in the unit of the field."""

    @property
    def chances(self) -> int:
        """How many values were looked through."""
        return max(1, sum(len(row) for row in self.places))

    @property
    def held(self) -> bool:
        """Whether no fit moves it."""
        return self.info.places is not None

    @property
    def counted(self) -> bool:
        """Whether its freedom is paid for by number: a fit moves it, and no prior states its size."""
        return not self.held and self.info.prior is None

    @property
    def name(self) -> str:
        """The parameter's name within its effect."""
        return self.field if self.item is None else f"{self.field}[{self.item}]"

    @property
    def full_name(self) -> str:
        """The parameter's name within the model, as files have it."""
        return f"{self.effect}.{self.name}"

    @cached_property
    def _scale(self) -> tuple[float, float, bool]:
        """(value at 0, length of 1, whether both are on the declared scale)."""
        info = self.info
        transformed = (
            info.scale != "log" or (info.shapes and info.typical > 0) or (info.off > 0 and info.typical > 0)
        )
        typical = info.to_scale(info.typical) if transformed else info.typical
        if info.shapes:
            length = math.log(10.0) if transformed and info.scale == "log" else abs(typical) or 1.0
            return typical, length, transformed
        off = info.to_scale(info.off) if transformed else info.off
        return off, typical - off, transformed

    def scaled_value(self, value: float) -> float:
        """The scaled value of `value` (in the field's unit)."""
        zero, length, transformed = self._scale
        return float(((self.info.to_scale(value) if transformed else value) - zero) / length)

    def value(self, scaled_value: float) -> float:
        """The field's value (in its unit) at a scaled value, within its bounds or exactly off."""
        zero, length, transformed = self._scale
        if scaled_value == 0.0 and not self.info.shapes:
            return self.info.off
        raw = zero + length * scaled_value
        value = self.info.from_scale(raw) if transformed else raw
        low, high = self.info.lower, self.info.upper
        if low <= value <= high:
            return float(value)
        nearest = low if value < low else high
        if not self.info.shapes and abs(scaled_value) < 0.5 * abs(self.scaled_value(nearest)):
            return self.info.off
        return float(nearest)

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest scaled value."""
        _, length, transformed = self._scale
        ends = []
        for value in (self.info.lower, self.info.upper):
            if value == 0 and transformed and self.info.scale != "linear":
                # 1/0 and log 0: as far as it goes, to the side on which it lies
                ends.append(math.copysign(FAR, length if self.info.scale == "reciprocal" else -length))
            else:
                ends.append(max(-FAR, min(FAR, self.scaled_value(value))))
        low, high = min(ends), max(ends)
        return (low, high) if self.info.shapes else (min(low, 0.0), max(high, 0.0))

    @property
    def one_sided(self) -> bool:
        """Whether off lies at the edge of what is possible."""
        low, high = self.bounds
        return not self.info.shapes and not (low < 0.0 < high)

    @cached_property
    def smallest(self) -> float:
        """Scaled value below which the size does not matter."""
        return 0.0 if self.info.shapes else abs(self.scaled_value(self.info.smallest))

    @property
    def prior_sd(self) -> float:
        """Prior standard deviation of the scaled value."""
        if self.held:
            return math.inf
        if self.info.shapes:
            return FORM_DECADES
        if self.info.prior is None:
            return WIDE
        size = (
            abs(self.info.off) if math.isfinite(self.info.off) and self.info.off else abs(self.info.typical)
        )
        return max(abs(self.scaled_value(self.info.off + self.info.prior * size)), 1e-6)


def free_parameters(
    effects: Mapping[str, type[Effect]],
    names: Sequence[str],
    layout: Layout,
    torque_scale: float = 1.0,
    places: Mapping[str, tuple[tuple[float, ...], ...]] | None = None,
) -> tuple[FreeParameter, ...]:
    """The free parameters of the named effects, in that order, on a shaft of that torque scale.

    `places` to try, by effect.
    """
    counts = {"sensor": len(layout.sensor_positions_m), "section": len(layout.tissue_sections_m)}
    found = []
    for name in names:
        for field, info in effects[name].parameters().items():
            items = [None] if info.per == "one" else list(range(counts[info.per]))
            scaled = info.scaled(torque_scale)
            tried = (places or {}).get(name, ()) if info.places is not None else ()
            found += [FreeParameter(name, field, item, scaled, tried) for item in items]
    return tuple(found)


def shared_names(parameters: Sequence[FreeParameter]) -> tuple[str, ...]:
    """Names of what all trials share, in the order of vectors: friction, torsional rigidity, the effects'."""
    return FRICTION, TORSIONAL_RIGIDITY, *(p.full_name for p in parameters)


def at_strength(parameters: Sequence[FreeParameter], strength: float, turn: float = 1.0) -> Array:
    """Scaled values (k,) of one effect's parameters at `strength` typical sizes; forms stay typical.

    What may have either sign takes that of `turn`, items of a field alternate; bounds cut.
    """
    scaled_values = np.zeros(len(parameters))
    for k, parameter in enumerate(parameters):
        if parameter.info.shapes:
            continue
        low, high = parameter.bounds
        odd = parameter.item is not None and parameter.item % 2 == 1
        sign = (-turn if odd else turn) if low < 0 < high else 1.0 if high > 0 else -1.0
        scaled_values[k] = min(max(sign * strength, low), high)
    return scaled_values


def constrained_means(parameters: Sequence[FreeParameter]) -> list[Array]:
    """Places of the items whose mean is constrained, an array for each such field."""
    fields: dict[tuple[str, str], list[int]] = {}
    for place, parameter in enumerate(parameters):
        if parameter.info.relative:
            fields.setdefault((parameter.effect, parameter.field), []).append(place)
    return [np.array(places) for places in fields.values()]


def against_mean(parameters: Sequence[FreeParameter], scaled_values: Array) -> Array:
    """Scaled values (k,) with every constrained mean brought back to off."""
    moved = scaled_values.copy()
    for places in constrained_means(parameters):
        values = np.array([parameters[i].value(float(scaled_values[i])) for i in places])
        if values.mean() > 0.0:
            share = parameters[places[0]].info.off / values.mean()
            moved[places] = [
                parameters[i].scaled_value(float(v * share)) for i, v in zip(places, values, strict=True)
            ]
    return moved


def make_effects(
    effects: Mapping[str, type[Effect]], parameters: Sequence[FreeParameter], scaled_values: Array
) -> tuple[Effect, ...]:
    """Effects with the values at `scaled_values`, one for each of `parameters`."""
    fields: dict[str, dict[str, float | list[float]]] = {}
    for parameter, scaled_value in zip(parameters, scaled_values, strict=True):
        value = parameter.value(float(scaled_value))
        values = fields.setdefault(parameter.effect, {})
        if parameter.item is None:
            values[parameter.field] = value
        else:
            values.setdefault(parameter.field, [])
            values[parameter.field].append(value)  # type: ignore[union-attr]
    return tuple(
        effects[name](**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})
        for name, values in fields.items()
    )


def scaled_values_of(parameters: Sequence[FreeParameter], effects: Sequence[Effect]) -> Array:
    """Scaled values (k,) of given effects; parameters of effects that are not given are off."""
    by_name = {e.name(): e for e in effects}
    found = np.zeros(len(parameters))
    for i, parameter in enumerate(parameters):
        effect = by_name.get(parameter.effect)
        if effect is not None:
            value = np.atleast_1d(np.asarray(getattr(effect, parameter.field), dtype=float))
            one = value[parameter.item if parameter.item is not None and value.size > 1 else 0]
            found[i] = (
                0.0
                if one == parameter.info.off and not parameter.info.shapes
                else parameter.scaled_value(float(one))
            )
    return found
