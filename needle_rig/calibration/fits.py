"""Fits of calibration measurements: what a node's page must hold so that its readings are true."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needle_rig.errors import RigFault
from needle_rig.numerics import Array
from needle_rig.units import deg

COUNTS_PER_FIELD = 1.0 / 16.0
"""A neutral Hall node sends 16 × the length of the pair of 12-bit counts, measured from 2048."""
_LEAST_SPAN_RAD = math.radians(330.0)


@dataclass(frozen=True)
class HallFit:
    """One sensor: offsets in counts from mid-scale, amplitudes in counts, angles in rad.

    angle = raw − zero − Σ amplitude_k·sin(k·raw + phase_k), k = 1, 2, with raw of the corrected pair.
    `residual_rad` (samples,) is the residual, at `angle_rad`.
    """

    sine_offset: float
    cosine_offset: float
    sine_amplitude: float
    cosine_amplitude: float
    zero_rad: float
    amplitude_rad: tuple[float, float]
    phase_rad: tuple[float, float]
    angle_rad: Array
    residual_rad: Array

    @property
    def gains(self) -> tuple[float, float]:
        """Factors of sine and of cosine that make both amplitudes their mean."""
        mean = (self.sine_amplitude + self.cosine_amplitude) / 2.0
        return mean / self.sine_amplitude, mean / self.cosine_amplitude


def fit_hall(base_rad: Array, raw_rad: Array, field: Array) -> HallFit:
    """Fit one sensor to a free needle's turns.

    `base_rad`, `raw_rad`, `field` (samples,): true angle; angle and field amplitude as a neutral node sends
    them. Least squares on the pair of counts of: offsets, amplitudes, and
    φ = θ + zero + Σ (a_k sin kθ + b_k cos kθ). Raises RigFault when the turn was too short to tell.
    """
    from scipy.optimize import least_squares

    span = float(np.ptp(base_rad))
    if span < _LEAST_SPAN_RAD:
        raise RigFault(
            f"the base turned by {deg(span):.0f}°; a calibration needs a full turn: turn on, and again"
        )
    length = field * COUNTS_PER_FIELD
    sine, cosine = length * np.sin(raw_rad), length * np.cos(raw_rad)
    size = float(np.median(length))
    zero = float(np.angle(np.mean(np.exp(1j * (raw_rad - base_rad)))))

    def angle(p: Array) -> Array:
        seen = base_rad + p[4]
        for k in (1, 2):
            seen = seen + p[3 + 2 * k] * np.sin(k * base_rad) + p[4 + 2 * k] * np.cos(k * base_rad)
        return np.asarray(seen)

    def residual(p: Array) -> Array:
        seen = angle(p)
        return np.concatenate(
            [sine / size - p[0] - p[2] * np.sin(seen), cosine / size - p[1] - p[3] * np.cos(seen)]
        )

    found = least_squares(residual, [0.0, 0.0, 1.0, 1.0, zero, 0.0, 0.0, 0.0, 0.0]).x
    offsets, amplitudes = found[:2] * size, found[2:4] * size
    raw = np.arctan2((sine - offsets[0]) / amplitudes[0], (cosine - offsets[1]) / amplitudes[1])
    terms = np.column_stack([np.ones_like(raw), *(f(k * raw) for k in (1, 2) for f in (np.sin, np.cos))])
    away = np.remainder(raw - base_rad - found[4] + math.pi, math.tau) - math.pi
    c = np.linalg.lstsq(terms, away, rcond=None)[0]
    return HallFit(
        float(offsets[0]),
        float(offsets[1]),
        float(amplitudes[0]),
        float(amplitudes[1]),
        math.remainder(float(found[4] + c[0]), math.tau),
        (math.hypot(c[1], c[2]), math.hypot(c[3], c[4])),
        (math.atan2(c[2], c[1]), math.atan2(c[4], c[3])),
        base_rad,
        away - terms @ c,
    )


@dataclass(frozen=True)
class LineFit:
    """y = offset + slope · x, and the residual of each point."""

    offset: float
    slope: float
    x: Array
    residual: Array


def fit_line(x: Array, y: Array, what: str) -> LineFit:
    """y = offset + slope · x by least squares, in the units of x (n,) and y (n,), with the residuals (n,).

    Raises RigFault when the points do not tell a line: fewer than two places, no slope.
    """
    if len(np.unique(x)) < 2:
        raise RigFault(f"{what}: one point only; measure at two or more")
    slope, offset = np.polyfit(x, y, 1)
    residual = y - (offset + slope * x)
    if abs(slope) * float(np.ptp(x)) < 10.0 * float(np.std(residual)) + 1e-12:
        raise RigFault(f"{what}: the readings do not follow what was done; look at cables and mounting")
    return LineFit(float(offset), float(slope), x, residual)
