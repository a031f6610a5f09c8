"""How well a generic shaft explains a channel from the angle that drives it.

The shaft is a sum of plays with weights of one sign (Prandtl and Ishlinskii), a spring and a damper. An angle
on it follows the drive and every play; a torque is what the spring, the stops of the plays and the damper
resist. The common sign tells what drives from what follows: no follower runs the loop of its driver.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache

import numpy as np
from scipy.optimize import nnls

from needle_rig.importing.guess.series import Series, values_at
from needle_rig.numerics import Array

ROWS = 1000
"""Means of equal blocks that are fitted; a loop of eight strokes keeps a hundred a stroke."""
WIDTHS = tuple(2.0**-k for k in range(1, 7))
"""Half widths of the plays over the driver's span, each half of the one before, down to the noise."""
NOISES = 4.0
"""Standard deviations of the driver's noise that the narrowest play is wide: within, it filters noise."""
FEWEST_ROWS = 20
"""Rows that determine nine weights with some left to judge them."""
HOME = 0.01
"""Share of the span within which the driver stands where it began."""
RESTING = 3
"""Means in a row that make it a stand."""
LEAST_LEFT = 1e-12
"""Share of the variance below which it is the rounding of the file."""


class Driver:
    """An angle taken as what drives the others."""

    def __init__(self, series: Series) -> None:
        self.series = series
        self.block = max(1, len(series.values) // ROWS)
        self._terms, self._factors = lru_cache(2)(self._design), lru_cache(4)(self._factored)

    @cached_property
    def angle(self) -> Array:
        """Means of blocks, over the span."""
        values = self._means(self.series.values)
        return values / max(float(np.nanmax(values) - np.nanmin(values)), 1e-300)

    @cached_property
    def _path(self) -> Array:
        """The angle from its start, filled in where it is not known."""
        known = np.isfinite(self.angle)
        x = np.interp(np.arange(len(self.angle)), np.flatnonzero(known), self.angle[known])
        return np.asarray(x - x[0])

    @cached_property
    def _let_go(self) -> tuple[frozenset[int], ...]:
        """Rows at which the shaft forgets: at none, or wherever the driver comes to stand as at its start."""
        home = np.convolve(np.abs(self._path) < HOME, np.ones(RESTING), "valid") == RESTING
        back = np.flatnonzero(home[1:] & ~home[:-1]) + 1
        return (frozenset(), frozenset(back.tolist())) if len(back) else (frozenset(),)

    def _design(self, let_go: frozenset[int]) -> tuple[Array, Array]:
        """Design of a follower and of a torque, both (rows, weights)."""
        x = self._path
        rate = np.gradient(x) * len(x)
        noise = float(np.median(np.abs(np.diff(x, 2)))) / (0.6745 * math.sqrt(6.0))
        widths = np.array([w for w in WIDTHS if w > NOISES * noise])
        plays = np.empty((len(x), len(widths)))
        at = np.zeros(len(widths))
        for k, value in enumerate(x):
            at = np.full(len(widths), value) if k in let_go else np.clip(at, value - widths, value + widths)
            plays[k] = at
        angle = x[:, None]
        return np.column_stack((angle, plays, -rate)), np.column_stack((angle, angle - plays, rate))

    def gain(self, other: Series, torque: bool = False) -> float:
        """Log odds (BIC) that the shaft moves `other`, an angle or its torque, over that nothing does."""
        values = self._means(values_at(self.series, other))
        known = np.isfinite(values) & np.isfinite(self.angle)
        if known.sum() < FEWEST_ROWS:
            return 0.0
        y = values[known] - values[known].mean()
        if not y.any():
            return 0.0
        y /= float(np.abs(y).max())  # squares of the smallest numbers there are would be 0
        return max(self._fitted(y, torque, known.tobytes(), let_go) for let_go in self._let_go)

    def _fitted(self, y: Array, torque: bool, known: bytes, let_go: frozenset[int]) -> float:
        """The gain by `y`, which has a mean of 0, at the `known` rows."""
        x, inside, triangle = self._factors(torque, known, let_go)
        target = inside.T @ y
        best, left = 0, y
        for sign in (1.0, -1.0):
            weights, _ = nnls(triangle, sign * target)
            rest = y - sign * (x @ weights)
            if rest @ rest < left @ left:
                least = math.sqrt(LEAST_LEFT) * float(weights.max(initial=0.0))
                best, left = int((weights > least).sum()), rest
        unexplained = float(left @ left) / float(y @ y)
        # rounding has neither a correlation nor a size that says anything
        count = _independent(left) if unexplained > LEAST_LEFT else float(len(left))
        unexplained = max(unexplained, LEAST_LEFT)
        return max(0.0, -0.5 * count * math.log(unexplained) - 0.5 * best * math.log(count))

    def _factored(self, torque: bool, known: bytes, let_go: frozenset[int]) -> tuple[Array, Array, Array]:
        """The design at the `known` rows, centred, over its norms, with its two factors."""
        x = self._terms(let_go)[torque][np.frombuffer(known, dtype=bool)]
        x = x - x.mean(axis=0)
        x = x / np.maximum(np.linalg.norm(x, axis=0), 1e-300)
        return x, *np.linalg.qr(x)

    def _means(self, values: Array) -> Array:
        blocks = values[: len(values) // self.block * self.block].reshape(-1, self.block)
        known = np.isfinite(blocks)
        total = np.where(known, blocks, 0.0).sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(total / known.sum(axis=1))


def _independent(left: Array) -> float:
    """Samples of a residual that count, by the correlation of neighbours beyond chance; two at least."""
    power = float(left @ left)
    near = float(left[1:] @ left[:-1]) / power if power > 0 else 0.0
    near = min(max(near - 2.0 / math.sqrt(len(left)), 0.0), 1.0)
    return max(2.0, len(left) * (1.0 - near) / (1.0 + near))
