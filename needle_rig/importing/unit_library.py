"""The one file that knows pint: an expression of units to its dimension and its size in SI."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Literal

Dimension = Literal["time", "angle", "rate", "length", "speed", "torque", "force", "other"]
_BASES: dict[frozenset[tuple[str, int]], Dimension] = {
    frozenset({("second", 1)}): "time",
    frozenset({("radian", 1)}): "angle",
    frozenset({("radian", 1), ("second", -1)}): "rate",
    frozenset({("meter", 1)}): "length",
    frozenset({("meter", 1), ("second", -1)}): "speed",
    frozenset({("kilogram", 1), ("meter", 1), ("second", -2)}): "force",
}
"""Dimensions that follow from base units; a torque and a joule have the same ones."""


@lru_cache(maxsize=1)
def _registry() -> Any:
    """Loaded when the first unit is read: it takes 0.6 s."""
    import pint

    return pint.UnitRegistry(on_redefinition="ignore")


@lru_cache(maxsize=4096)
def measured(expression: str) -> tuple[Dimension, float] | None:
    """Dimension and what one of it is in SI (NaN of any other); None for what is no unit.

    A torque is a force times a length; a joule, which has its dimension, is none.
    """
    registry = _registry()
    try:
        unit = registry.parse_units(expression, as_delta=True)
        si = registry.get_base_units(unit)
    except Exception:  # noqa: BLE001 - on what is no unit the parser raises anything, down to tokenize's errors
        return None
    # products of prefixes leave a rounding: 1e-9 is 1.0000000000000003e-09
    factor, base = float(f"{float(si[0]):.15g}"), dict(si[1]._units)
    known = _BASES.get(frozenset(base.items()))
    if known is not None:
        return known, factor
    if base == {"kilogram": 1, "meter": 2, "second": -2}:
        kinds = [registry.get_dimensionality(name) for name in unit._units]
        if len(kinds) == 2 and registry.get_dimensionality("newton") in kinds:
            return "torque", factor
    return "other", float("nan")
