"""Lack of fit by the pure-error F test: what replicates share against how they differ.

Cell means are those of each channel in each motion, moving and settled, freed of the correlations that the
noise model states. The mean of the replicates of a command holds the model's error, the differences among
them do not, whatever the noise is: so a wrong noise level does not pass for an effect, as in a plain χ².
Commands without replicates are held against the differences among the others' replicates.

What replicates share within the accuracy that the solver promises is no lack of fit: the statistic is held
against the noncentral F distribution that such errors give.

What random effects or the needle's constants can absorb is not seen here (wear, a torque gain): the test can
say that something is missing, not that nothing is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ncfdtr

from needle_rig.numerics import Array, lower_root
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.linear import LinearisedFit, Projection
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.measured_noise import floors
from needle_rig.workbench.observations.noise import Whitener
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.documents import FTest

Key = tuple[int, int, bool]
"""(channel, motion, moving) of one cell mean."""


@dataclass(frozen=True)
class LackOfFit:
    """The F test of one fit."""

    statistic: float
    """Mean square of what replicates share over that of how they differ."""
    shared_dof: int
    differing_dof: int
    p: float
    """That errors within the solver's accuracy share as much."""
    where: str
    """The channel and state with most of it, in words."""
    size: float
    """Root mean square there, in `unit`."""
    unit: str

    @property
    def significant(self) -> bool:
        """Whether the model lacks something that replicates share."""
        return self.p < POLICY.evidence.significance

    def sentence(self) -> str:
        """In words."""
        return (
            f"{self.where}: off by about {self.size:.2g} {self.unit}, alike in every replicate"
            f" (F = {self.statistic:.2f} on {self.shared_dof} and {self.differing_dof}, p = {self.p:.1g})"
        )

    def as_json(self) -> FTest:
        """As it stands in the JSON answer."""
        return {
            "f": float(f"{self.statistic:.4g}"),
            "dof": [self.shared_dof, self.differing_dof],
            "p": float(f"{self.p:.3g}"),
        }


def lack_of_fit(problem: Problem, found: Fit, sensors: tuple[str, ...]) -> LackOfFit | None:
    """The test of `found`, whose residuals are linearised in its parameters; None without replicates."""
    groups = problem.groups
    if all(len(g) <= 1 for g in groups):
        return None
    linear = LinearisedFit.of(problem, found)
    keys = [_shared_keys([problem.trials[t] for t in group], problem, group) for group in groups]
    ends = np.cumsum([len(chosen) for chosen in keys])
    means = np.zeros((ends[-1], linear.residuals.size))
    within, differing_dof, of_solver = 0.0, 0, 0.0
    for end, group, chosen in zip(ends, groups, keys, strict=True):
        averages = [_averages(problem.trials[t], problem.whiteners[t], chosen) for t in group]
        averagings = [
            _averaging_matrix(problem.whiteners[t], each, len(chosen))
            for t, each in zip(group, averages, strict=True)
        ]
        # an error that is alike in all trials of a group counts as often as there are trials
        of_solver += sum(_solver_error(problem, each, chosen) for each in averages)
        for t, averaging in zip(group, averagings, strict=True):
            means[end - len(chosen) : end, linear.rows[t]] = averaging / np.sqrt(len(group))
        if len(group) > 1:
            terms = [linear.trials[t] for t in group]
            seen = np.array([averaging @ t.residuals for averaging, t in zip(averagings, terms, strict=True)])
            random_effect = np.mean(
                [averaging @ t.random_effect for averaging, t in zip(averagings, terms, strict=True)], axis=0
            )
            direction = random_effect / (np.linalg.norm(random_effect) or 1.0)
            apart = seen - seen.mean(0)
            apart -= np.outer(apart @ direction, direction)
            within += float((apart**2).sum())
            differing_dof += (len(group) - 1) * (len(chosen) - 1)
    left = Projection(linear, means).missed
    shared_dof = len(means) - int((linear.precision == 0.0).sum())  # every other parameter has a prior
    if shared_dof < 1 or differing_dof < 1 or not within > 0:
        return None
    differing = within / differing_dof
    statistic = float(left @ left) / shared_dof / differing
    each = np.split(left, ends)[:-1]
    where, size, unit = _worst(problem, found, keys, each, differing, sensors)
    return LackOfFit(
        statistic,
        shared_dof,
        differing_dof,
        max(0.0, 1.0 - float(ncfdtr(shared_dof, differing_dof, of_solver / differing, statistic))),
        where,
        size,
        unit,
    )


def _shared_keys(binned: list[BinnedTrial], problem: Problem, group: list[int]) -> list[Key]:
    """Cells that every trial of a group has."""
    each = []
    for b, t in zip(binned, group, strict=True):
        channels = problem.whiteners[t].channels
        each.append({(c, int(b.motion[k]), bool(b.moving[k])) for c, w in enumerate(channels) for k in w.use})
    return sorted(set.intersection(*each))


Averages = tuple[tuple[int, list[int], Array], ...]
"""(channel, its cells, (cells, n) from its whitened values to their means), of one trial."""


def _averages(binned: BinnedTrial, whitener: Whitener, keys: list[Key]) -> Averages:
    found = []
    for c, channel in enumerate(whitener.channels):
        use = channel.use
        rows = [i for i, key in enumerate(keys) if key[0] == c]
        if not rows:
            continue
        average = np.zeros((len(rows), use.size))
        for i, row in enumerate(rows):
            _, motion, moving = keys[row]
            inside = (binned.motion[use] == motion) & (binned.moving[use] == moving)
            weight = binned.count[c][use] * inside
            average[i] = weight / weight.sum()
        found.append((c, rows, channel.of_averages(average)))
    return tuple(found)


def _averaging_matrix(whitener: Whitener, averages: Averages, cells: int) -> Array:
    """(cells, n): from whitened values of a trial to its cell means, independent and of unit variance."""
    averaging = np.zeros((cells, whitener.channel.size))
    for c, rows, given in averages:
        lower = lower_root(given @ given.T)
        place = np.flatnonzero(whitener.channel == c)
        averaging[np.ix_(np.asarray(rows), place)] = solve_triangular(lower, given, lower=True)
    return averaging


def _solver_error(problem: Problem, averages: Averages, keys: list[Key]) -> float:
    """Expected sum of squares of a trial's cell means, standardised as by `_averaging_matrix`, that come of
    errors within the solver's accuracy: from motion to motion, as the noise model has them."""
    floor = floors(problem.trials[0].mean.shape[0], problem.base.torque_scale)
    found = 0.0
    for c, rows, given in averages:
        motion = np.array([keys[row][1] for row in rows])
        alike = motion[:, None] == motion[None, :]
        found += float(floor[c] ** 2 * np.trace(np.linalg.solve(given @ given.T, alike)))
    return found


def _worst(
    problem: Problem,
    found: Fit,
    keys: list[list[Key]],
    left: list[Array],
    differing: float,
    sensors: tuple[str, ...],
) -> tuple[str, float, str]:
    """(words, size, unit) of the channel and state in which most is left beyond how replicates differ."""
    squares: dict[tuple[int, bool], list[float]] = {}
    raw: dict[tuple[int, bool], list[float]] = {}
    for group, chosen, values in zip(problem.groups, keys, left, strict=True):
        means = [_raw_means(problem, found, t, chosen) for t in group]
        for (channel, _, moving), value, mean in zip(chosen, values, np.mean(means, axis=0), strict=True):
            squares.setdefault((channel, moving), []).append(float(value) ** 2)
            raw.setdefault((channel, moving), []).append(float(mean) ** 2)
    place = max(squares, key=lambda k: (np.mean(squares[k]), k))
    beyond = max(0.0, 1.0 - differing / float(np.mean(squares[place])))
    rms = float(np.sqrt(beyond * np.mean(raw[place])))
    channel, moving = place
    name = ("torque", *sensors)[channel]
    size, unit = (nmm(rms), "N·mm") if channel == 0 else (deg(rms), "°")
    return f"{name} {'while moving' if moving else 'once settled'}", size, unit


def _raw_means(problem: Problem, found: Fit, trial: int, keys: list[Key]) -> list[float]:
    """Mean of data minus model in each cell, N·m and rad."""
    b, w = problem.trials[trial], problem.whiteners[trial]
    raw = w.raw(found.residuals[trial])
    means = []
    for channel, motion, moving in keys:
        use = w.channels[channel].use
        inside = (b.motion[use] == motion) & (b.moving[use] == moving)
        means.append(float(np.average(raw[channel][use][inside], weights=b.count[channel][use][inside])))
    return means
