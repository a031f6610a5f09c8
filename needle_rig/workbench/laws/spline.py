"""Curves without a form: penalised cubic B-splines whose smoothness the data set.

A curve is f(v) = Σ c_k B_k(v) on a uniform grid (P-splines: Eilers, Marx, Statistical Science 11 (1996)),
with the prior c ~ N(0, P⁻¹), P = (I + DᵀD/ρ²)/A², D second differences. Amplitude A and roughness ρ maximise
the likelihood of the data with c and all other parameters integrated out: restricted maximum likelihood
(Wood, J. R. Statist. Soc. B 73 (2011)). With c = S z, S Sᵀ = P⁻¹, a fit moves z, whose prior is N(0, 1).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline

from needle_rig.numerics import Array

DEGREE = 3
AMPLITUDES = 2.0 ** np.arange(-11, 8)
"""Factors on the amplitude of a curve that are tried,"""
ROUGHNESSES = (0.03, 0.1, 0.3, 1.0, 3.0)
"""and second differences of its coefficients in units of that amplitude: from near a line to rough."""


@dataclass(frozen=True)
class Spline:
    """A family of curves over `low` to `high`, constant beyond."""

    low: float
    high: float
    count: int
    """Coefficients."""
    amplitude: float
    roughness: float
    """Infinite where there is no smoothness."""

    def basis(self, at: Array) -> Array:
        """Values of the B-splines (n, count) at (n,)."""
        return np.asarray(BSpline.design_matrix(self._inside(at), self.knots, DEGREE).toarray())

    @property
    def spacing(self) -> float:
        """Distance of the knots."""
        return (self.high - self.low) / (self.count - DEGREE)

    @property
    def knots(self) -> Array:
        """Shape (count + 4,), beyond both ends."""
        return np.asarray(self.low + self.spacing * np.arange(-DEGREE, self.count + 1))

    @property
    def root(self) -> Array:
        """S (count, count)."""
        return _root(self.count, self.amplitude, self.roughness)

    @property
    def inverse(self) -> Array:
        """S⁻¹ (count, count)."""
        return np.asarray(np.linalg.inv(self.root), dtype=np.float64)

    def values(self, coefficients: Array, at: Array) -> Array:
        """The curve (n,) at (n,)."""
        return np.asarray(BSpline(self.knots, coefficients, DEGREE)(self._inside(at)))

    def _inside(self, at: Array) -> Array:
        knots = self.knots
        return np.clip(np.asarray(at, dtype=np.float64), knots[DEGREE], knots[self.count])


@dataclass(frozen=True, eq=False)
class Quadratic:
    """−2 log likelihood as a function of coefficients c, all else profiled out: cᵀ G c − 2 bᵀ c + const."""

    G: Array
    b: Array

    def fall(self, vectors: Array) -> tuple[float, Array]:
        """How far it falls in the span of `vectors` (K, m), and where (m,)."""
        square, right = vectors.T @ self.G @ vectors, vectors.T @ self.b
        size = np.sqrt(np.maximum(np.diag(square), 1e-300))
        at = np.linalg.lstsq(square / np.outer(size, size), right / size, rcond=1e-10)[0] / size
        return float(2.0 * at @ right - at @ square @ at), at

    def about(self, origin: Array) -> tuple[Quadratic, float]:
        """The same of what is added to coefficients, and how far it falls to these."""
        pushed = self.G @ origin
        return Quadratic(self.G, self.b - pushed), float((2.0 * self.b - pushed) @ origin)

    def over(self, dispersion: float) -> Quadratic:
        """The same of data whose variances are so many times larger (quasi-likelihood)."""
        return Quadratic(self.G / dispersion, self.b / dispersion)

    def scaled(self, root: Array) -> Quadratic:
        """The same of z, for c = S z."""
        return Quadratic(root.T @ self.G @ root, root.T @ self.b)


def smoothed(
    spline: Spline, of: Quadratic, unit: float, roughest: float = math.inf
) -> tuple[Spline, float, Array]:
    """The spline with the smoothness of largest restricted likelihood, twice its logarithm, and c (K,).

    Amplitudes are tried about `unit`. The logarithm is over that of no curve at all.
    """
    best: tuple[Spline, float, Array] | None = None
    for tried in _every_smoothness(spline, unit):
        if tried.roughness > roughest:
            continue
        gain, z, _ = _restricted(of.scaled(tried.root))
        if best is None or gain > best[1]:
            best = tried, gain, tried.root @ z
    assert best is not None
    return best


def covariance_about(spline: Spline, of: Quadratic, unit: float, coefficients: Array) -> Array:
    """Mean square (K, K) of the coefficients' distances from given ones, over all smoothnesses.

    Each smoothness has a share as its restricted likelihood: with one alone held fixed, a band is too narrow
    (Wood, Pya, Säfken, J. Am. Stat. Assoc. 111 (2016), sec. 4).
    """
    gains, squares = [], []
    for tried in _every_smoothness(spline, unit):
        gain, z, spread = _restricted(of.scaled(tried.root))
        off = tried.root @ z - coefficients
        gains.append(gain)
        squares.append(tried.root @ spread @ tried.root.T + np.outer(off, off))
    shares = np.exp(0.5 * (np.array(gains) - max(gains)))
    return np.asarray(np.tensordot(shares / shares.sum(), squares, 1))


def _every_smoothness(spline: Spline, unit: float) -> Iterator[Spline]:
    for roughness in ROUGHNESSES:
        for factor in AMPLITUDES:
            yield dataclasses.replace(spline, amplitude=float(unit * factor), roughness=roughness)


def _restricted(of: Quadratic) -> tuple[float, Array, Array]:
    """Twice the logarithm of the restricted likelihood, z (K,) and its covariance (K, K)."""
    whole = of.G + np.eye(of.b.size)
    spread = np.asarray(np.linalg.inv(whole), dtype=np.float64)
    z = spread @ of.b
    return float(of.b @ z - np.linalg.slogdet(whole)[1]), z, spread


@lru_cache(maxsize=512)
def _root(count: int, amplitude: float, roughness: float) -> Array:
    return amplitude * _unit_root(count, roughness)


@lru_cache(maxsize=128)
def _unit_root(count: int, roughness: float) -> Array:
    bends = np.diff(np.eye(count), 2, axis=0)
    precision = np.eye(count) + bends.T @ bends / roughness**2
    return np.asarray(np.linalg.inv(np.linalg.cholesky(precision)).T)
