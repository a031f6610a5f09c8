"""Friction of a plain joint: its torque against its rate, where no twist tells more.

τ = τ₀ + sign(ω) (F + S e^{−(ω/ω_s)²}) + b ω + J α: Coulomb friction F, offset τ₀, viscous friction b,
Stribeck's excess S at rest that fades with the rate ω_s, and inertia J where it shows. Source:
Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994); as a least-squares fit: Swevers, Verdonck,
De Schutter, "Dynamic model identification for industrial robots", IEEE Control Systems 27 (2007).

After a reversal friction builds up over the presliding, or over a play, which the stop operator z describes
(Brokate, Sprekels, "Hysteresis and phase transitions", 1996, ch. 2). Its width is the one of a ladder that
leaves least; what lies within it is not of the law and is left aside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import curve_fit
from scipy.stats import f as f_distribution
from scipy.stats import t as t_distribution

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.dataset.channels import white_noise
from needle_rig.numerics import Array, beyond_chance

RATE_NOISE = 0.01
"""Of a block's rate, over a high rate: blocks are as long as the encoder's noise asks for."""
HIGH = 0.9
"""Quantile of the rates that stands for a high one."""
ONE_WAY = 0.95
"""Share of a block's way that leads to its end at least: less of it, and the block holds a reversal."""
FEWEST = 20
"""Blocks that determine five numbers."""
OUTLYING = 2.385
"""Standard deviations beyond which residuals count less (Cauchy's loss): friction changes sides in a block.
It is 95 % as efficient as least squares where all is normal (Holland, Welsch, Commun. Statist. A6, 1977)."""
LEAST_LEFT = 1e-9
"""Of the torque's span: less is rounding."""
MEDIAN_TO_SIGMA = 1.4826
CHANCE = 1e-3
"""Probability below which a rate's sign, or an excess, is not one of noise."""
OTHER_WAY = "turn the base both ways"
DRAG = "drag"
"""Coulomb friction and offset together, of a base that turned one way."""
EITHER_SIGN = ("offset", DRAG)
"""Numbers that may be negative; the others are friction and inertia."""
TWO_RATES = 1.2
"""Ratio of a high to a low rate below which friction at one rate alone was seen."""
LOWEST = 1.0 - HIGH
FADED = 0.5
"""Of the highest rate, above which the rate of an excess would leave a fiftieth of it there, e^(−4)."""
WIDTHS = (0.0, *(2.0**-k for k in range(11, 2, -1)))
"""Half widths of the presliding that are tried, over the span of the base."""
BEYOND = math.sqrt(2.0)
"""Widths after a reversal that are left aside: a ladder in steps of two has one that is that near."""


@dataclass(frozen=True)
class Seen:
    """Means of blocks, each (blocks,): rates of one sign each in rad/s, accelerations, torques in N·m."""

    rate_rad_s: Array
    acceleration_rad_s2: Array
    torque_nm: Array
    built_up: Array
    """Share of the friction, −1 to 1, that is built up at either end of each block, (widths, 2, blocks)."""

    def slipping(self) -> Seen:
        """The blocks beyond the presliding, whose width is the one that leaves least."""

        def left(built_up: Array) -> float:
            x = np.column_stack(
                (built_up.mean(axis=0), np.ones_like(y), self.rate_rad_s, self.acceleration_rad_s2)
            )
            return float(np.sum((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2))

        y = self.torque_nm
        best = max(1, min(range(len(WIDTHS)), key=lambda k: left(self.built_up[k])))
        beyond = (np.abs(self.built_up[best]) == 1.0).all(axis=0)
        return Seen(
            self.rate_rad_s[beyond],
            self.acceleration_rad_s2[beyond],
            self.torque_nm[beyond],
            self.built_up[:, :, beyond],
        )


@dataclass(frozen=True)
class Number:
    """One value of the law with its standard deviation; None where the motion does not tell it."""

    name: str
    value: float | None
    deviation: float | None = None
    missing: str = ""
    """What would have to be recorded."""
    at_most: float | None = None
    """The size that 95 % leave possible, of one that is not told from 0."""


@dataclass(frozen=True)
class JointFriction:
    """The law's numbers in N·m, rad and s: coulomb, viscous, offset, stribeck and its rate, inertia.

    Of a base that turned one way the first is `drag`, Coulomb friction and offset in one.
    """

    numbers: tuple[Number, ...]
    reach: float
    """Standard deviations to either end of a 95 % interval."""
    left_nm: float
    """Root mean square of what the law leaves of the blocks."""

    def __getitem__(self, name: str) -> Number:
        return next(n for n in self.numbers if n.name == name)


def twist_is_seen(dataset: Dataset, least_rad: float) -> bool:
    """Whether any trial has a torque beside an angle that stays behind the base by `least_rad`."""
    for trial in dataset.trials:
        for sensor in range(trial.hall_rad.shape[1]):
            twist = trial.trial.base_angle_rad - trial.hall_rad[:, sensor]
            both = np.isfinite(twist) & trial.torque_ok
            if both.any() and float(np.ptp(twist[both])) > least_rad:
                return True
    return False


def seen(trials: Sequence[DatasetTrial]) -> Seen:
    """The rates and torques of all trials in blocks over which the base turns one way."""
    span_rad = max((float(np.ptp(t.trial.base_angle_rad)) for t in trials), default=0.0)
    blocks = [b for t in trials if t.torque_ok.any() and (b := _blocks(t, span_rad)) is not None]
    if not blocks:
        return Seen(np.empty(0), np.empty(0), np.empty(0), np.empty((len(WIDTHS), 2, 0)))
    return Seen(
        np.concatenate([b.rate_rad_s for b in blocks]),
        np.concatenate([b.acceleration_rad_s2 for b in blocks]),
        np.concatenate([b.torque_nm for b in blocks]),
        np.concatenate([b.built_up for b in blocks], axis=2),
    )


def _built_up(angle_rad: Array, width_rad: float) -> Array:
    """The stop operator over its width (ends,), −1 to 1; the first stroke begins at 0."""
    share = np.zeros_like(angle_rad)
    at = 0.0
    for k, step in enumerate((np.diff(angle_rad) / width_rad).tolist(), start=1):
        at = min(max(at + step, -1.0), 1.0)
        share[k] = at
    return share


def _blocks(trial: DatasetTrial, span_rad: float) -> Seen | None:
    time_s, base_rad = trial.trial.time_s, trial.trial.base_angle_rad
    known = np.isfinite(trial.base_measured_rad)
    noise_rad = min(white_noise(trial.base_measured_rad[known]), trial.base_residual_rad)
    step_s = float(np.median(np.diff(time_s)))
    rates = np.abs(np.diff(base_rad) / np.diff(time_s))
    moving = rates[rates > 0]
    if not len(moving):
        return None
    high_rad_s = float(np.quantile(moving, HIGH))
    wanted = math.ceil(math.sqrt(2.0) * noise_rad / (RATE_NOISE * high_rad_s * step_s))
    count = int(np.clip(wanted, 1, max(1, len(time_s) - 1)))
    ends = np.arange(0, len(time_s), count)
    way = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(base_rad)))))
    length_s, turned, path = (np.diff(x[ends]) for x in (time_s, base_rad, way))
    torque = np.where(trial.torque_ok, trial.torque_nm, 0.0)
    # a mean over both ends, as the rate is one between them
    total = np.concatenate(([0.0], np.cumsum((torque[1:] + torque[:-1]) / 2)))
    there = np.concatenate(([0.0], np.cumsum(trial.torque_ok[1:] & trial.torque_ok[:-1])))
    mean, share = (np.diff(x[ends]) / count for x in (total, there))
    rate = turned / length_s
    noise_rad_s = math.sqrt(2.0) * noise_rad / (count * step_s)
    sure_rad_s = beyond_chance(CHANCE, len(rate)) * noise_rad_s
    good = (share == 1.0) & (np.abs(rate) > max(sure_rad_s, 1e-9 * high_rad_s))
    good &= np.abs(turned) >= ONE_WAY * path
    shares = [
        np.stack((share[:-1], share[1:]))
        for w in WIDTHS
        if w > 0
        for share in [_built_up(base_rad[ends], w * BEYOND * span_rad)]
    ]
    built_up = np.stack([np.tile(np.sign(rate), (2, 1)), *shares])
    middle_s = (time_s[ends][1:] + time_s[ends][:-1]) / 2
    acceleration = np.gradient(rate, middle_s) if len(rate) > 1 else np.zeros_like(rate)
    return Seen(rate[good], acceleration[good], mean[good], built_up[:, :, good])


def joint_friction(found: Seen) -> JointFriction | None:
    """The law's numbers by least squares; None from fewer blocks than tell it.

    Residuals of neighbours hang together, so that fewer blocks count: by their correlation, as of a process
    of first order.
    """
    if len(found.rate_rad_s) >= FEWEST:
        found = found.slipping()
    rate, torque = found.rate_rad_s, found.torque_nm
    if len(rate) < FEWEST or not np.ptp(torque):
        return None
    both_ways = min((rate > 0).mean(), (rate < 0).mean()) > 1.0 / FEWEST
    low, high = np.quantile(np.abs(rate), (LOWEST, HIGH))
    two_rates = high > TWO_RATES * low
    together = {"coulomb": np.sign(rate), "offset": np.ones_like(rate)}
    # one way alone Coulomb friction and offset are one constant
    columns = (together if both_ways else {DRAG: np.ones_like(rate)}) | (
        {"viscous": rate} if two_rates else {}
    )
    turned = {**columns, "inertia": found.acceleration_rad_s2}
    left_nm = _typical(turned, torque)
    fit, names = _linear(columns, rate, torque, left_nm), list(columns)
    if found.acceleration_rad_s2.any():
        heavy = _linear(turned, rate, torque, left_nm)
        if heavy.is_better(fit):
            columns, fit, names = turned, heavy, list(turned)
    if two_rates and both_ways:
        bent = _with_stribeck(np.column_stack(list(columns.values())), rate, torque, fit, left_nm)
        if bent is not None:
            fit, names = bent, [*names, "stribeck", "stribeck_rate"]
    reach = float(t_distribution.ppf(0.975, max(fit.count - len(fit.at), 1.0)))
    values = {
        n: Number(n, float(v), float(s), at_most=_most(n, float(v), reach * float(s)))
        for n, v, s in zip(names, fit.at, fit.deviations, strict=True)
    }
    slowest = float(np.abs(rate).min())
    bounds: dict[str, float] = {}
    if two_rates:
        bounds["stribeck"] = _most_excess(columns, rate, torque, left_nm, reach)
    elif both_ways:
        # what grows with the rate is at most all the friction that there is at this one
        bounds["viscous"] = float((fit.at[0] + reach * fit.deviations[0]) / np.median(np.abs(rate)))
    faster = "turn at rates that lie a factor of five apart"
    slower = f"turn more slowly than {math.degrees(slowest):.2g}°/s, evenly, both ways"
    missing = dict.fromkeys(("coulomb", "offset", "stribeck"), OTHER_WAY) if not both_ways else {}
    missing = {"viscous": faster, "stribeck": f"no excess is seen at low rates: {slower}"} | missing
    asked_for = (*(() if both_ways else (DRAG,)), "coulomb", "viscous", "offset", "stribeck")
    told = (
        *(
            values.get(name) or Number(name, None, None, missing[name], bounds.get(name))
            for name in asked_for
        ),
        *(values[name] for name in ("stribeck_rate", "inertia") if name in values),
    )
    return JointFriction(told, reach, math.sqrt(fit.chi2 / len(rate)))


def _most(name: str, value: float, half: float) -> float | None:
    """The size that an interval with 0 in it reaches, and None of one without; friction is none below 0."""
    if abs(value) > half:
        return None
    return half + (abs(value) if name in EITHER_SIGN else max(value, 0.0))


@dataclass(frozen=True)
class _Fit:
    at: Array
    deviations: Array
    chi2: float
    count: float
    """Blocks that count."""

    def is_better(self, than: _Fit) -> bool:
        """Whether its further numbers explain more than chance does (F test)."""
        free, more = self.count - len(self.at), len(self.at) - len(than.at)
        if free <= 1.0 or not np.isfinite(self.deviations).all():
            return False
        gain = (than.chi2 - self.chi2) / more / max(self.chi2 / free, 1e-300)
        return float(f_distribution.sf(gain, more, free)) < CHANCE


def _typical(columns: Mapping[str, Array], torque: Array) -> float:
    """What plain least squares leave, as a standard deviation that outlying blocks do not move."""
    design = np.column_stack(list(columns.values()))
    left = torque - design @ np.linalg.lstsq(design, torque, rcond=None)[0]
    return MEDIAN_TO_SIGMA * float(np.median(np.abs(left)))


def _linear(columns: Mapping[str, Array], rate: Array, torque: Array, left_nm: float) -> _Fit:
    design = np.column_stack(list(columns.values()))
    begin = np.asarray(np.linalg.lstsq(design, torque, rcond=None)[0], dtype=np.float64)
    return _fit(lambda _, *p: design @ np.array(p), rate, torque, begin, left_nm)


def _fit(
    law: Callable[..., Array],
    rate: Array,
    torque: Array,
    begin: Sequence[float] | Array,
    left_nm: float,
    bounds: tuple[list[float], list[float]] | None = None,
) -> _Fit:
    """Least squares of `law(rate, *numbers)` that leaves some `left_nm`; what lies far beyond hardly counts.

    Raises RuntimeError where it does not converge.
    """
    limits = bounds or ([-np.inf] * len(begin), [np.inf] * len(begin))
    scale_nm = OUTLYING * max(left_nm, LEAST_LEFT * float(np.ptp(torque)))
    at, covariance = curve_fit(
        law, rate, torque, np.array(begin), bounds=limits, method="trf", loss="cauchy", f_scale=scale_nm
    )
    left = np.clip(torque - law(rate, *at), -scale_nm, scale_nm)
    near = float(left[1:] @ left[:-1]) / max(float(left @ left), 1e-300)
    near = max(near, 0.0)  # below 1, by Cauchy and Schwarz
    share = (1.0 - near) / (1.0 + near)
    return _Fit(at, np.sqrt(np.diag(covariance) / share), float(left @ left), max(len(left) * share, 1.0))


def _most_excess(
    columns: Mapping[str, Array], rate: Array, torque: Array, left_nm: float, reach: float
) -> float:
    """The largest excess that the blocks leave possible, whatever the rate is at which it fades."""
    ends = []
    for fading in _fadings(rate):
        excess = np.sign(rate) * np.exp(-((rate / fading) ** 2))
        fit = _linear({**columns, "stribeck": excess}, rate, torque, left_nm)
        ends.append(max(float(fit.at[-1]), 0.0) + reach * float(fit.deviations[-1]))
    return max(ends)


def _fadings(rate: Array) -> Array:
    """Rates at which an excess may fade and be seen to."""
    lowest, highest = float(np.abs(rate).min()), float(np.abs(rate).max())
    return np.geomspace(max(2.0 * lowest, 1e-3 * highest), FADED * highest, 4)


def _with_stribeck(design: Array, rate: Array, torque: Array, plain: _Fit, left_nm: float) -> _Fit | None:
    """The fit with an excess at low rates; None where it is no better than chance makes it.

    None as well where the excess has not faded at the highest rate, or where drag that grows with the square
    of the rate, as of a propeller, leaves less.
    """
    sign, size = np.sign(rate), np.abs(rate)

    def law(_: Array, *numbers: float) -> Array:
        *linear, excess, fading = numbers
        return np.asarray(design @ np.array(linear) + sign * excess * np.exp(-((size / fading) ** 2)))

    lowest, highest, free = float(size.min()), float(size.max()), len(plain.at)
    tried = []
    for fading in _fadings(rate):
        begin = [*plain.at, 0.1 * abs(float(plain.at[0])), float(fading)]
        limits = ([-np.inf] * free + [0.0, lowest], [np.inf] * (free + 1) + [highest])
        try:
            tried.append(_fit(law, rate, torque, begin, left_nm, limits))
        except RuntimeError:  # no convergence from there
            continue
    best = min(tried, key=lambda f: f.chi2, default=None)
    if best is None or not best.is_better(plain) or best.at[-1] >= FADED * highest:
        return None
    rival = np.column_stack((design, rate * size))
    at = np.asarray(np.linalg.lstsq(rival, torque, rcond=None)[0], dtype=np.float64)
    squared = _fit(lambda _, *p: rival @ np.array(p), rate, torque, at, left_nm)
    return None if squared.chi2 < best.chi2 else best
