"""What the motion of a needle tells of its recording: which channel leads, which sign, which unit.

All follows from a passive shaft that starts relaxed: the work done on it is never negative, and what is
driven comes after what drives.
"""

from __future__ import annotations

import math

import numpy as np

from needle_rig.dataset.base_path import denoised_base
from needle_rig.dataset.channels import FULL_TURN_RAD, unwrapped
from needle_rig.numerics import Array

LOOKED_AT = 20_000
"""Samples of a recording from which a guess is made; every n-th is taken of longer ones."""
CLEAR_LAG = 0.004
"""Of the product of travels: two records of one angle with 0.25° of noise differ by 0.002, the angles of the
practice needles come 0.13 and more after their base (test_thresholds)."""
CLEAR_WORK = 0.15
"""Share of the work: noise alone gives some 1.8/√samples, the practice needles 0.23 and more."""
LEAST_WRAP = 0.8
"""Share of a turn that a wrapped angle jumps by at least: 72° between samples are left to its motion."""
MOST_BETWEEN = 0.2
"""Share of a turn between samples once it is unwrapped; beyond, nobody can say which way it went."""
TURNS = (
    360.0,
    2.0 * math.pi,
    1.0,
    *(float(1 << bits) for bits in range(8, 25)),
    1000.0,
    2000.0,
    4000.0,
    36000.0,
)
"""Where angles of encoders and trackers wrap: degrees, radians, turns, counts."""
LEVELS, TURN_LEVELS = 8, 2
"""Even levels of a path's span, and how many in a row the base passes one way in a stroke: noise of a tenth
of the span does not."""
ROUND_STEP_DEG = 5.0
ROUND_WITHIN_DEG = 0.2
"""Commands are multiples of 5° and drives reach them; 8 % of levels at random are that near to one."""


def without_wraps(values: Array, turn: float | None) -> Array:
    """An angle (samples,) without its jumps by a `turn`, in its unit; None finds the turn, if it wraps.

    Nothing is changed where the values reach farther than a turn: they count on.
    """
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if len(known) else 0.0
    steps = np.abs(np.diff(known))
    if span == 0.0 or steps.max() < LEAST_WRAP * span:
        return values
    for length in TURNS if turn is None else (turn,):
        if LEAST_WRAP * length < span <= length * (1 + 1e-9):
            plain, first = unwrapped(values * (FULL_TURN_RAD / length))
            plain = plain * (length / FULL_TURN_RAD)
            left = np.abs(np.diff(plain[np.isfinite(plain)]))
            if first is not None and left.max() < MOST_BETWEEN * length:
                return np.asarray(plain, dtype=np.float64)
    return values


def work_share(base: Array, torque: Array) -> float:
    """∫τ dθ over ∫|τ dθ|, −1 to 1, of a shaft that starts relaxed; both (samples,), torque zero at the start.

    A passive shaft gives back no more than it got: below zero the sign is wrong, or the columns are.
    """
    known = np.isfinite(base) & np.isfinite(torque)
    steps = np.diff(base[known])
    middle = (torque[known][1:] + torque[known][:-1]) / 2.0
    total = float(np.abs(middle * steps).sum())
    return float((middle * steps).sum()) / total if total > 0.0 else 0.0


def lag_share(leader: Array, follower: Array) -> float:
    """Area by which `follower` comes after `leader`, over the product of their spans; both (samples,).

    The path in the plane of both turns left about a follower: ½∮(x dy − y dx) > 0. Independent of offsets of
    closed paths, of scale, and, as a product of signs, of which way either counts.
    """
    known = np.isfinite(leader) & np.isfinite(follower)
    x, y = leader[known] - leader[known][0], follower[known] - follower[known][0]
    span = float(np.ptp(x) * np.ptp(y)) if len(x) else 0.0
    if span == 0.0:
        return 0.0
    area = float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum()) / 2.0
    sign = 1.0 if np.dot(x, y) >= 0.0 else -1.0
    return sign * area / span


def follow_sign(base: Array, angle: Array) -> float:
    """Correlation of an angle with the base, −1 to 1."""
    known = np.isfinite(base) & np.isfinite(angle)
    if known.sum() < 10 or np.ptp(base[known]) == 0.0 or np.ptp(angle[known]) == 0.0:
        return 0.0
    return float(np.corrcoef(base[known], angle[known])[0, 1])


def levels(time_s: Array, base: Array) -> Array:
    """Where the base rests or turns, relative to where it begins; each once, in the unit of `base`."""
    known = np.isfinite(base)
    time_s, base = time_s[known], base[known]
    span = float(np.ptp(base)) if len(base) else 0.0
    if span == 0.0 or len(base) < 20:
        return np.empty(0)
    # denoised_base judges cleanness in radians; the shape alone counts here.
    path = denoised_base(time_s, (base - base[0]) / span)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], path.holding.view(np.int8), [0]))))
    held = [
        float(np.median(path.angle_rad[a:b]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if time_s[min(b, len(time_s)) - 1] - time_s[a] > 0.2
    ]
    start = held[0] if held else 0.0
    if len(held) < 2:
        held = [start, float(path.angle_rad.max()), float(path.angle_rad.min())]
    found: list[float] = []
    for level in held:
        if abs(level - start) > 0.02 and all(abs(level - start - f) > 0.01 for f in found):
            found.append(level - start)
    return np.array(found) * span


def roundness(levels_deg: Array) -> float:
    """Share of the levels that are multiples of 5°, 0 without levels."""
    return float(np.mean(_round(levels_deg))) if len(levels_deg) else 0.0


def round_by_chance(levels_deg: Array) -> float:
    """Probability that of as many levels at random as many are multiples of 5°; 1 without levels."""
    from scipy.stats import binom

    if not len(levels_deg):
        return 1.0
    share = float(np.mean(np.minimum(1.0, 2.0 * _round_within(levels_deg) / ROUND_STEP_DEG)))
    return float(binom.sf(_round(levels_deg).sum() - 1, len(levels_deg), share))


def _round(levels_deg: Array) -> Array:
    near = np.abs(levels_deg - ROUND_STEP_DEG * np.round(levels_deg / ROUND_STEP_DEG))
    return np.asarray((near < _round_within(levels_deg)) & (np.abs(levels_deg) > ROUND_STEP_DEG / 2))


def _round_within(levels_deg: Array) -> Array:
    """How near to a multiple a drive comes: the farther it turns, the less near."""
    return np.maximum(ROUND_WITHIN_DEG, 0.003 * np.abs(levels_deg))


def rest_before_motion(base: Array) -> int:
    """Samples from the first one on in which the base has not moved, at least one."""
    known = base[np.isfinite(base)]
    if not len(known):
        return 1
    away = np.abs(base - known[0]) > 0.01 * max(float(np.ptp(known)), 1e-12)
    first = np.flatnonzero(away)
    return max(1, int(first[0]) * 9 // 10 if first.size else len(base))


def from_rest(values: Array, rest: int) -> Array:
    """`values` less their mean over the first `rest` samples, or over the first known ones."""
    known = np.flatnonzero(np.isfinite(values))
    begin = known[known < rest]
    zero = float(values[begin if len(begin) else known[:5]].mean()) if len(known) else 0.0
    return np.asarray(values - zero, dtype=np.float64)


def first_stiffness(base: Array, torque: Array, within: float) -> float:
    """Slope of the torque over the base's angle while that first goes `within` from its start, absolute; 0
    if unknown.

    Both (samples,), zero at the start; the slope is in their units. Friction has not yet let the shaft slip
    then.
    """
    known = np.isfinite(base) & np.isfinite(torque)
    x, y = base[known], torque[known]
    beyond = np.flatnonzero(np.abs(x) > within)
    end = int(beyond[0]) if beyond.size else len(x)
    x, y = x[:end], y[:end]
    power = float(x @ x)
    return abs(float(x @ y)) / power if power > 0 else 0.0


def peak_rate(time_s: Array, angle: Array) -> float:
    """The rate that a fiftieth of the steps exceeds, in the unit of `angle` a second: no outlier gives it."""
    known = np.isfinite(angle) & np.isfinite(time_s)
    steps = np.diff(time_s[known])
    good = steps > 0
    if not good.any():
        return 0.0
    rates = np.abs(np.diff(angle[known])[good] / steps[good])
    return float(np.quantile(rates, 0.98))


def stroke_samples(path: Array) -> float:
    """Samples (the median) from one turn back of a path (samples,) to the next; inf with fewer than two.

    A path turns back where it passes `TURN_LEVELS` even levels of its span the other way: noise passes one to
    and fro.
    """
    span = float(np.ptp(path)) if len(path) else 0.0
    if not 0.0 < span < math.inf:
        return math.inf
    level = np.minimum((path - path.min()) * (LEVELS / span), LEVELS - 1).astype(np.int64)
    at = np.flatnonzero(np.diff(level)) + 1
    way = np.diff(level)[at - 1]
    first = np.flatnonzero(np.diff(np.sign(way), prepend=0))
    strokes = np.flatnonzero(np.abs(np.add.reduceat(way, first)) >= TURN_LEVELS)
    begins, side = at[first[strokes]], np.sign(way[first[strokes]])
    turns = begins[1:][np.diff(side) != 0]
    return float(np.median(np.diff(turns))) if len(turns) > 1 else math.inf


def clock_offset_s(time_a: Array, a: Array, time_b: Array, b: Array) -> tuple[float, float]:
    """What to add to the times of `b` for the best match with `a`, s, and the correlation there.

    Cross-correlation of the rates of both on the slower one's samples, refined by a parabola.
    """
    step = max(float(np.median(np.diff(time_a))), float(np.median(np.diff(time_b))))
    grid_a = np.arange(time_a[0], time_a[-1], step)
    grid_b = np.arange(time_b[0], time_b[-1], step)
    if len(grid_a) < 10 or len(grid_b) < 10:
        return 0.0, 0.0
    x, y = (
        _centred(np.interp(g, t[np.isfinite(v)], v[np.isfinite(v)]))
        for g, t, v in ((grid_a, time_a, a), (grid_b, time_b, b))
    )
    size = 1 << (len(x) + len(y) - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size)
    lags = np.concatenate((np.arange(len(x)), np.arange(-len(y) + 1, 0)))
    values = np.concatenate((product[: len(x)], product[size - len(y) + 1 :]))
    best = int(np.argmax(values))
    norm = math.sqrt(float(x @ x) * float(y @ y))
    before, at, after = (float(product[(int(lags[best]) + d) % size]) for d in (-1, 0, 1))
    bend = before - 2 * at + after
    part = 0.5 * (before - after) / bend if bend < 0 else 0.0
    offset = (float(lags[best]) + part) * step + float(grid_a[0] - grid_b[0])
    return offset, at / norm if norm > 0 else 0.0


def difference_share(time_a: Array, a: Array, time_b: Array, b: Array) -> float:
    """What is left of `a` when `b`, scaled and shifted, is taken from it: standard deviation over span.

    One quantity recorded twice leaves its noise; a needle that lags leaves its loop.
    """
    inside = (time_a >= time_b[0]) & (time_a <= time_b[-1]) & np.isfinite(a)
    if inside.sum() < 10:
        return 1.0
    known = np.isfinite(b)
    y, x = a[inside], np.interp(time_a[inside], time_b[known], b[known])
    design = np.column_stack((x, np.ones_like(x)))
    left = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    span = float(np.ptp(y))
    return float(left.std()) / span if span > 0 else 1.0


def refined_offset_s(
    time_a: Array, a: Array, time_b: Array, b: Array, near_s: float, within_s: float
) -> tuple[float, float]:
    """The offset within `within_s` of `near_s` that leaves least of `a` beside `b`, s, and that share."""
    from scipy.optimize import minimize_scalar

    def left(offset_s: float) -> float:
        return difference_share(time_a, a, time_b + offset_s, b)

    best = minimize_scalar(
        left, bounds=(near_s - within_s, near_s + within_s), method="bounded", options={"xatol": 1e-4}
    )
    return float(best.x), float(best.fun)


def _centred(values: Array) -> Array:
    return np.asarray(values - values.mean(), dtype=np.float64)
