"""A fit linearised: the linear-Gaussian model with its derivatives as design matrix.

For steps δ of the P = p + T + q parameters (p shared by all trials: friction, rigidity, scaled values; the
random effect of each of T trials; q coefficients of nuisances), −2 log posterior is

    Σ_t |r_t − A_t δ|² + (d + δ)ᵀ W (d + δ),

with whitened residuals r_t (n,) and design matrix A_t of a trial, the distance d of the parameters from the
priors' centre, and the priors' precision W (diagonal). Constraints on means of items are linear: δ lies in
their null space. So does it in that of the differences between the random effects of blocks of one recorded
trial. The random effects are draws about a common level, so tests leave their mean free; the steps of a fit
constrain it, too (`level`), since it is not identifiable beside the common friction.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg import null_space

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.parameters import FreeParameter, constrained_means
from needle_rig.workbench.estimation.posterior import level
from needle_rig.workbench.estimation.problem import EXACT, Fit, Problem
from needle_rig.workbench.policy import POLICY

Places = npt.NDArray[np.int64]

UNSEEN = 1e-3
"""Relative curvature, of parameters scaled to unit curvature each, below which a direction has no
information."""

ROUNDING = 1e-12
"""Share of a curvature that is left of it by rounding alone when the trials' parts are taken from their sum:
some 1e4 times the last bit."""


@dataclass(frozen=True)
class TrialTerms:
    """One trial of n whitened values, linear in its parameters."""

    residuals: Array
    """Data minus model (n,)."""
    columns: Array
    """Design matrix (n, p + 1 + q): derivatives by shared parameters, random effect, nuisances."""
    p: int
    random_effect_precision: float
    """Prior precision of the trial's random effect."""

    @cached_property
    def shared(self) -> Array:
        """Derivatives (n, s = p + q) by what all trials share, nuisances last."""
        return np.delete(self.columns, self.p, axis=1)

    @property
    def random_effect(self) -> Array:
        """Derivative by the trial's random effect (n,)."""
        return np.asarray(self.columns[:, self.p])

    @property
    def stiffness(self) -> float:
        """Curvature along the trial's random effect."""
        return float(self.random_effect @ self.random_effect) + self.random_effect_precision

    def information(self) -> Array:
        """Curvature (s, s) of the shared parameters, the random effect profiled out."""
        cross = self.shared.T @ self.random_effect
        return np.asarray(self.shared.T @ self.shared - np.outer(cross, cross) / self.stiffness)

    def random_effect_step(self, residuals: Array, at: float) -> float:
        """Gauss–Newton step of the random effect from `at`, for residuals (n,)."""
        return (float(self.random_effect @ residuals) - self.random_effect_precision * at) / self.stiffness

    def push(self, residuals: Array, at: float) -> Array:
        """Half the slope of −χ² (s,) for residuals (n,) at random effect `at`, which is profiled out."""
        return np.asarray(
            self.shared.T @ (residuals - self.random_effect * self.random_effect_step(residuals, at))
        )


@dataclass(frozen=True)
class LinearisedFit:
    """The linear-Gaussian model of a fit. Vectors (P,) hold p shared parameters, T random effects, q
    nuisances."""

    trials: tuple[TrialTerms, ...]
    from_centre: Array
    """The parameters' distance d from the priors' centre (P,)."""
    precision: Array
    """Prior precisions (P,); 0 where there is no prior."""
    constrained_means: tuple[Array, ...]
    """Places of the items whose mean is constrained, an array for each such field."""
    recorded: Places
    """The place (T,) of each trial's recorded trial: blocks of one have one random effect."""
    fixed: tuple[int, ...] = ()
    """Places of shared parameters that do not move."""
    uncounted: tuple[int, ...] = ()
    """Places of the scaled values whose freedom is not paid for by number (`FreeParameter.counted`)."""

    @classmethod
    def at(
        cls,
        problem: Problem,
        parameters: Sequence[FreeParameter],
        x: Array,
        residuals: Sequence[Array],
        jacobians: Sequence[Array],
        random_effect_precision: float,
    ) -> LinearisedFit:
        """About parameters x (P,), from whitened residuals (n,) and derivatives (n, p or p + 1) a trial.

        The last of p + 1 columns is by the random effect; of p columns the first serves for it, too.
        """
        p, recorded = 2 + len(parameters), problem.recorded
        precisions = random_effect_precision / np.bincount(recorded)[recorded]
        trials = tuple(
            TrialTerms(
                rows,
                np.column_stack([j[:, :p], j[:, p if j.shape[1] > p else 0], n]),
                p,
                float(precise),
            )
            for rows, j, n, precise in zip(residuals, jacobians, problem.nuisance, precisions, strict=True)
        )
        from_centre = x.copy()
        from_centre[0] = 0.0
        from_centre[1] -= float(np.log(problem.base.torsional_rigidity_nm2))
        widths = np.array([a.prior_sd for a in parameters])
        nuisances = np.ones(x.size - p - len(trials))
        precision = np.r_[0.0, problem.rigidity_prior**-2, widths**-2, precisions, nuisances]
        fixed = tuple(problem.fixed_places(parameters, x[2:p]))
        for place in fixed:
            from_centre[place], precision[place] = 0.0, EXACT**-2
        means = tuple(2 + places for places in constrained_means(parameters))
        uncounted = tuple(2 + k for k, a in enumerate(parameters) if not a.counted)
        return cls(trials, from_centre, precision, means, recorded, fixed, uncounted)

    @classmethod
    def of(cls, problem: Problem, fit: Fit) -> LinearisedFit:
        """About a minimum."""
        vector = fit.vector
        x = np.r_[
            vector.log_friction,
            vector.log_rigidity,
            vector.scaled_values,
            vector.trial_friction,
            fit.nuisance,
        ]
        return cls.at(problem, fit.parameters, x, fit.residuals, fit.jacobians, fit.scatter**-2)

    @property
    def p(self) -> int:
        """Number of shared parameters without nuisances: friction, rigidity, scaled values."""
        return self.trials[0].p

    @cached_property
    def random_effects(self) -> Places:
        """Places of the random effects."""
        return np.arange(self.p, self.p + len(self.trials), dtype=np.int64)

    @cached_property
    def shared(self) -> Places:
        """Places of what all trials share, nuisances last."""
        return np.delete(np.arange(self.precision.size, dtype=np.int64), self.random_effects)

    def _places(self, trial: int) -> Places:
        """Places of a trial's columns."""
        return np.concatenate([self.shared[: self.p], self.random_effects[[trial]], self.shared[self.p :]])

    @cached_property
    def residuals(self) -> Array:
        """Whitened residuals of all trials (N,), trial after trial."""
        return np.concatenate([t.residuals for t in self.trials])

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """Each trial's place among all N values."""
        ends = np.cumsum([0, *(t.residuals.size for t in self.trials)])
        return tuple(slice(begin, end) for begin, end in itertools.pairwise(ends.tolist()))

    @cached_property
    def columns(self) -> Array:
        """Derivatives of all values (N, P)."""
        matrix = np.zeros((self.residuals.size, self.precision.size))
        for t, (terms, rows) in enumerate(zip(self.trials, self.rows, strict=True)):
            matrix[rows, self._places(t)] = terms.columns
        return matrix

    @cached_property
    def curvature(self) -> Array:
        """Half the second derivative of −2 log posterior (P, P)."""
        curvature = np.zeros((self.precision.size, self.precision.size))
        for t, terms in enumerate(self.trials):
            places = self._places(t)
            curvature[np.ix_(places, places)] += terms.columns.T @ terms.columns
        curvature[np.diag_indices_from(curvature)] += self.precision
        return curvature

    @cached_property
    def level(self) -> Array:
        """Curvature (P, P) of the constraints: on means of items, and on that of the random effects."""
        curvature = np.zeros((self.precision.size, self.precision.size))
        for places in (self.random_effects, *self.constrained_means):
            curvature[places[:, None], places] += level(self.fixed) / places.size**2
        curvature[np.ix_(self.random_effects, self.random_effects)] += level(self.fixed) * self._apart
        return curvature

    @property
    def _apart(self) -> Array:
        """Projection (T, T) onto differences between blocks of one recorded trial; 0 without blocks."""
        alike = self.recorded[:, None] == self.recorded
        return np.asarray(np.eye(self.recorded.size) - alike / alike.sum(axis=1))

    def constraints(self) -> Array:
        """Rows (m, P) to which every step is orthogonal."""
        apart = np.zeros((self.recorded.size, self.precision.size))
        apart[:, self.random_effects] = self._apart
        return np.vstack([_means(self.constrained_means, np.ones_like(self.precision)), apart])

    @cached_property
    def descent(self) -> Array:
        """Half the slope of −2 log posterior (P,), downwards, with the means constrained."""
        slope = np.zeros(self.precision.size)
        for t, terms in enumerate(self.trials):
            slope[self._places(t)] += terms.columns.T @ terms.residuals
        slope -= self.precision * self.from_centre + self.level @ self.from_centre
        return slope

    @cached_property
    def _inverse(self) -> Array:
        """Covariance of all parameters (P, P), every mean constrained."""
        return np.asarray(np.linalg.pinv(self.curvature + self.level, hermitian=True))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of friction, rigidity and scaled values (p, p), all others marginalised.

        The mean of the random effects, which is constrained, has itself a variance: what it does to the
        parameters that it is confounded with is added.
        """
        shared, random_effect = (
            np.concatenate([t.columns[:, places] for t in self.trials]) for places in (slice(self.p), self.p)
        )
        moving = np.delete(np.arange(self.p), self.fixed)
        carried = np.zeros(self.p)
        carried[moving] = np.linalg.lstsq(shared[:, moving], random_effect, rcond=1e-9)[0]
        variance_of_mean = 1.0 / self.precision[self.p] / len(self.trials)
        return np.asarray(self._inverse[: self.p, : self.p] + variance_of_mean * np.outer(carried, carried))

    @cached_property
    def rank(self) -> int:
        """Directions among the counted scaled values that the data see, all other parameters projected
        out."""
        inside = np.setdiff1d(np.arange(2, self.p), self.uncounted)
        if not inside.size:
            return 0
        outside = np.setdiff1d(np.arange(self.precision.size), inside)
        cross = self.curvature[np.ix_(inside, outside)]
        rest = self.curvature[np.ix_(outside, outside)] + 1e-9 * np.eye(outside.size)
        left = self.curvature[np.ix_(inside, inside)] - cross @ np.linalg.solve(rest, cross.T)
        means = [np.searchsorted(inside, places) for places in self.constrained_means]
        free = _free(_means(means, np.ones(inside.size)))
        return max(
            1, int((np.linalg.eigvalsh(free.T @ left @ free) > POLICY.evidence.seen_information).sum())
        )

    @cached_property
    def information(self) -> tuple[Array, ...]:
        """Each trial's information on the shared parameters (s, s), its random effect profiled out."""
        return tuple(t.information() for t in self.trials)

    def without(self, group: Sequence[int]) -> tuple[Array, Array]:
        """Curvature and covariance (s, s) of the shared parameters without a group of trials.

        Directions without information in the rest have no variance: they do not move.
        """
        whole = sum(self.information) + np.diag(self.precision[self.shared])
        left = whole - sum(self.information[t] for t in group)
        size = np.sqrt(_curvatures(left, whole))
        alike = left / np.outer(size, size)
        free = _free(_means(self.constrained_means, size))
        seen = np.linalg.pinv(free.T @ alike @ free, rcond=UNSEEN, hermitian=True)
        return left, free @ seen @ free.T / np.outer(size, size)

    @cached_property
    def projection(self) -> Projection:
        """Projection of whitened values onto what the parameters cannot fit."""
        return Projection(self)


class Projection:
    """Projects the parameters of a linearised fit out of whitened vectors (Frisch–Waugh–Lovell theorem).

    `missed` is the projected residual. The priors are rows of it: an effect may show in the priors' pulls
    alone. `means` (m, N) takes the values of all trials to m independent ones of unit variance, which then
    stand in their place.
    """

    def __init__(self, fit: LinearisedFit, means: Array | None = None) -> None:
        columns, residuals = fit.columns, fit.residuals
        if means is not None:
            columns, residuals = means @ columns, means @ residuals
        self._prior_weight = np.sqrt(fit.precision)
        self.size = residuals.size
        self._random_effects = self.size + fit.random_effects
        matrix = np.vstack([columns, np.diag(self._prior_weight)]) @ _free(fit.constraints())
        self._basis, _ = np.linalg.qr(matrix)
        self._random_effect_weight = self._prior_weight[fit.random_effects]
        left = np.r_[residuals, -self._prior_weight * fit.from_centre]
        self.missed: Array = left - self._basis @ (self._basis.T @ left)

    def __call__(self, vectors: Array, random_effects: Array | None = None) -> Array:
        """The part of (n,) or (n, m) over all trials that the parameters cannot fit, with the priors' P rows
        below.

        `random_effects` (T,) are changes of the random effects that go with it: rows of their prior.
        """
        padded = np.zeros((self._basis.shape[0], *vectors.shape[1:]))
        padded[: self.size] = vectors
        if random_effects is not None:
            padded[self._random_effects] = random_effects * self._random_effect_weight
        return np.asarray(padded - self._basis @ (self._basis.T @ padded))

    def rigidity(self) -> Array:
        """The projected unit vector of the stated rigidity's prior row: how rigidity stands against the
        data."""
        row = self.size + 1
        stated = -self._basis @ self._basis[row]
        stated[row] += 1.0
        return np.asarray(stated)


def prediction_covariance(covariance: Array, random_effect_variance: float, columns: Array) -> Array:
    """Covariance (n, n) of n values of a future trial, from that of p shared parameters (p, p).

    `columns` (n, p + 1) is its design matrix, its random effect last.
    """
    shared, last = columns[:, :-1], columns[:, -1]
    return np.asarray(shared @ covariance @ shared.T + random_effect_variance * np.outer(last, last))


def _curvatures(left: Array, whole: Array) -> Array:
    """Diagonal (n,) of `left`, a part of `whole`, to divide by: that of `whole` where rounding is all of it,
    1 where nothing sees the parameter."""
    remaining, all_of_it = np.diag(left), np.diag(whole)
    scale = np.where(all_of_it > 0.0, all_of_it, 1.0)
    return np.where(remaining > ROUNDING * scale, remaining, scale)


def _means(constrained_means: Sequence[Array | Places], size: Array) -> Array:
    """Rows (m, n) of the constrained means of n parameters in units of 1 / `size`."""
    rows = np.zeros((len(constrained_means), size.size))
    for row, places in zip(rows, constrained_means, strict=True):
        row[places] = 1.0 / size[places]
    return rows


def _free(rows: Array) -> Array:
    """Orthonormal directions (n, ≤ n) of n parameters that are orthogonal to the rows (m, n)."""
    return np.asarray(null_space(rows)) if rows.any() else np.eye(rows.shape[1])
