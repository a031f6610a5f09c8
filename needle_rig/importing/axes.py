"""Channels that are neither angle nor torque: a speed is summed up, what slides goes over a lever."""

from __future__ import annotations

import math

import numpy as np

from needle_rig.dataset.channels import white_noise
from needle_rig.importing.unit_text import Unit
from needle_rig.numerics import Array

OF_ANGLE = ("angle", "rate", "length", "speed")
"""Dimensions of what becomes an angle."""
OF_TORQUE = ("torque", "force")
SUMMED = ("rate", "speed")
SLIDING = ("length", "speed", "force")
STANDS_S = 0.2
"""So long in a row a speed within its noise is a stand."""
NOISES = 4.0
LARGEST_ZERO = 0.02
"""Error of a zero over the largest speed up to which a stand is seen as one."""
UNSEEN_ZERO = 1e-3
"""Share of the largest speed that stands for the error of a zero that is not seen, as of tachometers."""


USUAL_LEVER_MM = 10.0
"""Stands for a lever that nobody said yet."""


def needs_lever(unit: Unit | None) -> bool:
    """Whether one of the unit is an angle or a torque by a lever alone."""
    return unit is not None and unit.dimension in SLIDING


def size_si(unit: Unit, lever_mm: float | None) -> float:
    """What one of `unit` is in rad, rad/s or N·m; NaN where it lacks its lever."""
    if unit.dimension not in SLIDING:
        return unit.si
    lever_m = math.nan if lever_mm is None else lever_mm * 1e-3
    return unit.si * lever_m if unit.dimension == "force" else unit.si / lever_m


def summed(time_s: Array, rate: Array) -> Array:
    """The way (samples,) from 0 on at a `rate` (samples,) a second, by trapezoids; gaps are bridged."""
    from scipy.integrate import cumulative_trapezoid

    known = np.isfinite(rate) & np.isfinite(time_s)
    if known.sum() < 2:
        return np.full(len(rate), math.nan)
    way = np.full(len(rate), math.nan)
    filled = np.interp(time_s, time_s[known], rate[known])
    inside = np.isfinite(time_s)
    way[inside] = cumulative_trapezoid(filled[inside], time_s[inside], initial=0)
    return way


def drift(time_s: Array, rate: Array) -> tuple[float, float, bool]:
    """How far a summed `rate` (samples,) may be off at its end: by its noise, by its zero; and if it stands.

    In the unit of the way. White noise makes a random walk of σ √(Δt T). Where the rate stands its mean is
    its zero error; elsewhere a share of its largest value stands for that.
    """
    length_s = float(time_s[-1] - time_s[0])
    noise = white_noise(rate)
    walk = noise * math.sqrt(length_s * length_s / max(len(rate) - 1, 1))
    largest = float(np.nanmax(np.abs(rate)))
    still = np.abs(rate) <= max(NOISES * noise, LARGEST_ZERO * largest)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.view(np.int8), [0]))))
    stands = [
        (a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if time_s[b - 1] - time_s[a] >= STANDS_S
    ]
    if not stands:
        return walk, UNSEEN_ZERO * largest * length_s, False
    zero = float(np.mean(np.concatenate([rate[a:b] for a, b in stands])))
    return walk, abs(zero) * length_s, True


def drift_sentence(
    role: str, source: str, time_s: Array, rate: Array, unit: Unit, lever_mm: float | None
) -> str:
    """The note on the drift of a channel that is summed from a speed."""
    size = math.degrees(size_si(unit, lever_mm))
    walk, zero, stands = drift(time_s, rate)
    length_s = float(time_s[-1] - time_s[0])
    seen = (
        f"its mean where it stands by {zero * size:.2g}°"
        if stands
        else f"a zero error of {UNSEEN_ZERO:.1%} of its largest value by {zero * size:.2g}° (it never stands)"
    )
    return (
        f"{role} is integrated from {source}: over {length_s:.3g} s its noise makes it drift by"
        f" {walk * size:.2g}°, {seen}. Friction over speed does not depend on that"
    )
