"""Residual patterns: the largest of many generic functions in what a fit leaves, in words.

The functions are of what is known of each bin (time, motion, angle, torque, order, …), on groups of
channels. Each is whitened and freed of what the fit's parameters can make; under noise alone it is a standard
normal, so the largest of all has a known distribution. What rigidity and
random effects absorb is tested by itself: a rigidity far from its stated value, and a trend of friction over
the trials.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtr

from needle_rig.dataset.records import UNKNOWN_SIGMA
from needle_rig.numerics import Array, beyond_chance
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.observations.binning import BinnedTrial, direction_of
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.values import spelt_sigmas

NEEDLE = "the needle"
MOST_PATTERNS = 5
"""Patterns that are reported."""
TINY = 1e-9
"""Length of a function that is none but for rounding."""
SILENT = 1e-12
"""Value of a function, rad or N·m, where it does not act."""


@dataclass(frozen=True)
class Pattern:
    """One generic function that is significant in the residuals."""

    channel: str
    law: str
    sigmas: float
    size: float
    """Root mean square of the fitted function where it acts, in `unit`."""
    unit: str
    share: float
    """Share of the gain of all significant patterns."""

    def sentence(self) -> str:
        """In words."""
        return (
            f"{self.channel} {self.law} (about {self.size:.2g} {self.unit}, {spelt_sigmas(self.sigmas)},"
            f" {100 * self.share:.0f} % of the residual)"
        )


@dataclass(frozen=True)
class ResidualPatterns:
    """The significant patterns of a fit's residuals."""

    patterns: tuple[Pattern, ...]
    gain: float
    """Fall of the objective that fitting all patterns would bring."""

    @property
    def significant(self) -> bool:
        """Whether more is left than noise."""
        return bool(self.patterns)


def functions(
    binned: BinnedTrial, torque_nm: Array, angle_rad: Array, order: int, trials: int
) -> dict[str, Array]:
    """Generic functions of the bins (K,), by the words that say what they follow."""
    settled = ~binned.moving
    way = direction_of(binned.last_move_rad)
    size = np.abs(binned.last_move_rad)
    before = np.r_[0.0, way[np.searchsorted(binned.motion, np.unique(binned.motion))]]
    earlier = before[binned.motion]
    travel = np.cumsum(np.abs(np.r_[0.0, np.diff(binned.base_rad)]))
    scale = torque_nm / (np.max(np.abs(torque_nm)) or 1.0)
    late = (order / max(1, trials - 1)) - 0.5
    time = binned.time_s / (binned.time_s[-1] or 1.0) - 0.5
    relaxing = {t: np.exp(-binned.since_stop_s / t) * settled * way for t in (0.3, 1.0, 4.0)}
    return {
        "is off by a constant": np.ones_like(time),
        "drifts with time within a trial": time,
        "drifts with the order of the trials": np.full_like(time, late),
        "drifts with the order of the trials, along the torque": late * scale,
        "follows the direction of motion, while moving": np.sign(binned.base_rate_rad_s),
        "is proportional to the rate of motion": binned.base_rate_rad_s,
        "grows with the speed, whatever the direction": np.abs(binned.base_rate_rad_s),
        "follows the direction of the last motion, once settled": way * settled,
        "follows the size of the last motion, once settled": binned.last_move_rad * settled,
        "follows the direction of motion after a reversal": way * (earlier * way < 0) * binned.moving,
        "follows the direction of motion when it goes on the same way": way
        * (earlier * way > 0)
        * binned.moving,
        "is settled differently after a reversal": way * (earlier * way < 0) * settled,
        "relaxes within 0.3 s of a stop": relaxing[0.3],
        "relaxes within 1 s of a stop": relaxing[1.0],
        "relaxes within 4 s of a stop": relaxing[4.0],
        "grows with the logarithm of the time since a stop": way * np.log1p(binned.since_stop_s) * settled,
        "is proportional to the base angle": binned.base_rad,
        "grows with the base angle, whatever its sign": np.abs(binned.base_rad),
        "follows the sine of the base angle": np.sin(binned.base_rad),
        "follows the cosine of the base angle": np.cos(binned.base_rad),
        "follows the sine of twice the base angle": np.sin(2 * binned.base_rad),
        "follows the cosine of twice the base angle": np.cos(2 * binned.base_rad),
        "is proportional to its own angle": angle_rad,
        "follows the sine of its own angle": np.sin(angle_rad),
        "follows the cosine of its own angle": np.cos(angle_rad),
        "follows the sine of twice its own angle": np.sin(2 * angle_rad),
        "follows the cosine of twice its own angle": np.cos(2 * angle_rad),
        "follows the sine of three times its own angle": np.sin(3 * angle_rad),
        "follows the cosine of three times its own angle": np.cos(3 * angle_rad),
        "is proportional to the torque": scale,
        "grows with the torque, whatever its sign": np.abs(scale),
        "follows the cube of the torque": scale**3,
        "follows the torque times its size": scale * np.abs(scale),
        "is proportional to the twist between base and sensor": binned.base_rad - angle_rad,
        "grows with the distance travelled": travel,
        "follows the torque times the distance travelled": scale * travel,
        "follows the size of the motion, while moving": way * size * binned.moving,
    }


def testable(left: Array, whole: Array) -> npt.NDArray[np.bool_]:
    """Which functions, of lengths `whole`, can be tested by the lengths that projection leaves of them."""
    return np.asarray(left > POLICY.verdict.testable_share * whole + TINY)


def find_residual_patterns(problem: Problem, found: Fit, sensors: tuple[str, ...]) -> ResidualPatterns:
    """The significant patterns of a fit's residuals, by forward selection: each is fitted beside those
    before."""
    project = LinearisedFit.of(problem, found).projection
    readings = problem.predict(found.parameters, found.vector)
    columns, names = _whitened_functions(problem, readings, sensors)
    lengths = np.sqrt((columns**2).sum(0))
    projected = np.column_stack([project(columns), project.rigidity()])
    stated = "stated" if problem.rigidity_prior < UNKNOWN_SIGMA else "assumed"
    names.append(
        (NEEDLE, f"is {'stiffer' if found.pull_rigidity > 0 else 'softer'} in torsion than {stated}")
    )
    lengths = np.r_[lengths, 1.0]
    seen_lengths = np.sqrt((projected**2).sum(0))
    usable = testable(seen_lengths, lengths)
    projected, lengths = projected[:, usable] / seen_lengths[usable], seen_lengths[usable]
    names = [n for n, u in zip(names, usable, strict=True) if u]
    limit = POLICY.evidence.clear_of(len(names))
    picked: list[tuple[int, float]] = []
    left, basis = project.missed, projected.copy()
    for _ in range(min(MOST_PATTERNS, len(names))):
        seen = basis.T @ left
        best = int(np.argmax(np.abs(seen)))
        if abs(seen[best]) < limit:
            break
        picked.append((best, float(seen[best])))
        direction = basis[:, best] / np.sqrt(basis[:, best] @ basis[:, best])
        left = left - direction * (direction @ left)
        basis = basis - np.outer(direction, direction @ basis)
        size = np.sqrt((basis**2).sum(0))
        basis = np.where(testable(size, np.ones_like(size)), basis / np.maximum(size, TINY), 0.0)
    trend = _trend(problem, found)
    gain = sum(z**2 for _, z in picked) + sum(p.sigmas**2 for p in trend)
    patterns = [
        _pattern(problem, readings, sensors, names[i], z, abs(z) / lengths[i], z**2 / gain) for i, z in picked
    ]
    both = (*patterns, *(replace(p, share=p.sigmas**2 / gain) for p in trend))
    return ResidualPatterns(both, gain)


def _pattern(
    problem: Problem,
    readings: list[Array],
    sensors: tuple[str, ...],
    name: tuple[str, str],
    sigmas: float,
    times: float,
    share: float,
) -> Pattern:
    """A pattern of the function `name`, of which `times` is the fitted coefficient."""
    channel, law = name
    if channel == NEEDLE:
        percent = 100 * float(np.expm1(times * problem.rigidity_prior))
        return Pattern(channel, law, sigmas, percent, "%", share)
    unit = "N·mm" if channel == "torque" else "°"
    return Pattern(channel, law, sigmas, times * _raw_size(problem, readings, sensors, name), unit, share)


def _trend(problem: Problem, found: Fit) -> list[Pattern]:
    """A significant trend of the random effects over the trials, none or one.

    Blocks of one recorded trial have one friction: their mean counts once.
    """
    recorded = problem.recorded

    def mean(values: Array | list[float]) -> Array:
        return np.asarray(np.bincount(recorded, values) / np.bincount(recorded))

    trial_friction = mean(found.vector.trial_friction)
    along = {
        "changes with the order of the trials": mean([float(b.trial.index) for b in problem.trials]),
        "changes with the angle turned before": mean([b.trial.travel_before_rad for b in problem.trials]),
    }
    freedom = trial_friction.size - 2
    trends = []
    for law, course in along.items():
        course = course - course.mean()
        if freedom <= 1 or not course @ course > 0.0:
            continue
        slope = float(course @ (trial_friction - trial_friction.mean()) / (course @ course))
        left = trial_friction - trial_friction.mean() - slope * course
        t = slope * np.sqrt(freedom * (course @ course) / max(left @ left, 1e-30))
        z = float(np.sign(t) * -ndtri(max(stdtr(freedom, -abs(t)), 1e-300)))
        size = 100 * abs(slope) * float(np.sqrt(np.mean(course**2)))
        trends.append(Pattern("the trials' friction", law, z, size, "%", 0.0))
    limit = beyond_chance(POLICY.evidence.trend, len(along))
    return sorted((p for p in trends if abs(p.sigmas) > limit), key=lambda p: -abs(p.sigmas))[:1]


def _groups(problem: Problem, sensors: tuple[str, ...]) -> dict[str, Array]:
    """Weights of the channels in each group."""
    count = 1 + len(sensors)
    groups = {"torque": np.eye(count)[0]}
    for i, name in enumerate(sensors):
        groups[name] = np.eye(count)[i + 1]
    if len(sensors) > 1:
        place = np.asarray(problem.base.layout.sensor_positions_m)
        deep = (place - place.mean()) / (np.ptp(place) or 1.0)
        groups["every angle"] = np.r_[0.0, np.ones(len(sensors))]
        groups["the deeper the sensor the more its angle"] = np.r_[0.0, deep + 0.5]
        groups["deep angles against near ones"] = np.r_[0.0, deep]
    return groups


def _raw(problem: Problem, readings: list[Array], t: int) -> list[dict[str, Array]]:
    binned, reading = problem.trials[t], readings[t]
    return [
        functions(
            binned,
            reading[0],
            reading[c] if c else reading[1:].mean(0) if reading.shape[0] > 1 else binned.base_rad,
            t,
            len(problem.trials),
        )
        for c in range(reading.shape[0])
    ]


def _whitened_functions(
    problem: Problem, readings: list[Array], sensors: tuple[str, ...]
) -> tuple[Array, list[tuple[str, str]]]:
    groups = _groups(problem, sensors)
    names = [(g, f) for g in groups for f in _raw(problem, readings, 0)[0]]
    blocks = []
    for t, whiten in enumerate(problem.whiteners):
        each = _raw(problem, readings, t)
        laws = list(each[0])
        raw = np.stack([np.stack([each[c][f] for f in laws], -1) for c in range(len(each))])
        parts = [whiten(raw * weight[:, None, None]) for weight in groups.values()]
        blocks.append(np.hstack(parts))
    return np.vstack(blocks), names


def _raw_size(
    problem: Problem, readings: list[Array], sensors: tuple[str, ...], name: tuple[str, str]
) -> float:
    weight = _groups(problem, sensors)[name[0]]
    values = []
    for t in range(len(problem.trials)):
        each = _raw(problem, readings, t)
        values += [weight[c] * each[c][name[1]] for c in range(len(each)) if weight[c]]
    flat = np.concatenate(values)
    acting = np.abs(flat) > SILENT
    rms = float(np.sqrt(np.mean(flat[acting] ** 2))) if acting.any() else 0.0
    return nmm(rms) if name[0] == "torque" else deg(rms)
