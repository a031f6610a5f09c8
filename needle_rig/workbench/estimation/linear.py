"""A fit as the linear-Gaussian model that its derivatives make of it: what its parameters can make, and how
well they are known.

For steps δ of the P = p + T + q parameters (p that all trials share: friction, rigidity, positions; the own
friction of each of T trials; q coefficients of nuisances), −2 log posterior is

    Σ_t |r_t − A_t δ|² + (d + δ)ᵀ W (d + δ),

with whitened residuals r_t (n,) of a trial, their columns A_t, the distance d of the parameters from the
priors' centre, and the priors' precision W (diagonal). Items that count against their mean move so that it
stays: δ lies in the null space of these means. The trials' own frictions are draws about a common level: no
test may hold their mean. A fit's steps hold it, too (`level`), or it would trade places with friction.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.linalg import null_space

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.parameters import Coordinate, held_means
from needle_rig.workbench.estimation.posterior import LEVEL
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.policy import POLICY

if TYPE_CHECKING:
    from needle_rig.workbench.estimation.map_fit import Fit

Places = npt.NDArray[np.int64]

UNSEEN = 1e-3
"""Directions of less curvature than this, of parameters scaled alike, are not followed."""


@dataclass(frozen=True)
class TrialTerms:
    """One trial of n whitened values, linear in its parameters."""

    residuals: Array
    """Data minus model (n,)."""
    columns: Array
    """Derivatives of the model (n, p + 1 + q): shared parameters, own friction, nuisances."""
    p: int
    own_precision: float
    """Prior precision of the trial's own friction."""

    @cached_property
    def shared(self) -> Array:
        """Derivatives (n, s = p + q) by what all trials share, nuisances last."""
        return np.delete(self.columns, self.p, axis=1)

    @property
    def own(self) -> Array:
        """Derivative by the trial's own friction (n,)."""
        return np.asarray(self.columns[:, self.p])

    @property
    def stiffness(self) -> float:
        """Curvature along the trial's own friction."""
        return float(self.own @ self.own) + self.own_precision

    def information(self) -> Array:
        """Curvature (s, s) of the shared parameters, the trial's own friction profiled out."""
        cross = self.shared.T @ self.own
        return np.asarray(self.shared.T @ self.shared - np.outer(cross, cross) / self.stiffness)

    def own_step(self, residuals: Array, at: float) -> float:
        """Where residuals (n,) take the own friction from `at`."""
        return (float(self.own @ residuals) - self.own_precision * at) / self.stiffness

    def push(self, residuals: Array, at: float) -> Array:
        """Half the slope of −χ² (s,) for residuals (n,) at own friction `at`, which follows."""
        return np.asarray(self.shared.T @ (residuals - self.own * self.own_step(residuals, at)))


@dataclass(frozen=True)
class LinearisedFit:
    """The model of the module's text. Vectors (P,) hold p shared parameters, T own frictions, q nuisances."""

    trials: tuple[TrialTerms, ...]
    from_centre: Array
    """The parameters' distance d from the priors' centre (P,)."""
    precision: Array
    """Of the priors (P,); 0 where there is none."""
    held: tuple[Array, ...]
    """Places of the items whose mean is held, an array for each such field."""

    @classmethod
    def at(
        cls,
        problem: Problem,
        axes: Sequence[Coordinate],
        x: Array,
        residuals: Sequence[Array],
        jacobians: Sequence[Array],
        own_precision: float,
    ) -> LinearisedFit:
        """About parameters x (P,), from whitened residuals (n,) and derivatives (n, p or p + 1) a trial.

        The last of p + 1 columns is the trial's own friction; of p columns the first serves for it, too.
        """
        p = 2 + len(axes)
        trials = tuple(
            TrialTerms(
                rows, np.column_stack([j[:, :p], j[:, p if j.shape[1] > p else 0], n]), p, own_precision
            )
            for rows, j, n in zip(residuals, jacobians, problem.nuisance, strict=True)
        )
        from_centre = x.copy()
        from_centre[0] = 0.0
        from_centre[1] -= float(np.log(problem.base.torsional_rigidity_nm2))
        widths = np.array([a.width for a in axes])
        own, nuisances = np.full(len(trials), own_precision), np.ones(x.size - p - len(trials))
        precision = np.r_[0.0, problem.rigidity_prior**-2, widths**-2, own, nuisances]
        return cls(trials, from_centre, precision, tuple(2 + places for places in held_means(axes)))

    @classmethod
    def of(cls, problem: Problem, fit: Fit) -> LinearisedFit:
        """About a minimum."""
        point = fit.point
        x = np.r_[point.log_friction, point.log_rigidity, point.positions, point.trial_friction, fit.nuisance]
        return cls.at(problem, fit.axes, x, fit.residuals, fit.jacobians, fit.scatter**-2)

    @property
    def p(self) -> int:
        """Number of friction, rigidity and positions."""
        return self.trials[0].p

    @cached_property
    def own(self) -> Places:
        """Places of the trials' own friction."""
        return np.arange(self.p, self.p + len(self.trials), dtype=np.int64)

    @cached_property
    def shared(self) -> Places:
        """Places of what all trials share, nuisances last."""
        return np.delete(np.arange(self.precision.size, dtype=np.int64), self.own)

    def _places(self, trial: int) -> Places:
        """Places of a trial's columns."""
        return np.concatenate([self.shared[: self.p], self.own[[trial]], self.shared[self.p :]])

    @cached_property
    def residuals(self) -> Array:
        """Of all N values, trial after trial."""
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
        """Curvature (P, P) that holds the means: of items that count against it, of the trials' friction."""
        curvature = np.zeros((self.precision.size, self.precision.size))
        for places in (self.own, *self.held):
            curvature[places[:, None], places] += LEVEL / places.size**2
        return curvature

    @cached_property
    def descent(self) -> Array:
        """Half the slope of −2 log posterior (P,), downwards, with the means held."""
        slope = np.zeros(self.precision.size)
        for t, terms in enumerate(self.trials):
            slope[self._places(t)] += terms.columns.T @ terms.residuals
        slope -= self.precision * self.from_centre + self.level @ self.from_centre
        return slope

    @cached_property
    def _inverse(self) -> Array:
        """Covariance of all parameters (P, P), every mean held."""
        return np.asarray(np.linalg.pinv(self.curvature + self.level, hermitian=True))

    @cached_property
    def covariance(self) -> Array:
        """Of friction, rigidity and positions (p, p), all others marginalised.

        The trials' mean, which is held, is a draw of their scatter: how far it would carry the parameters
        that it can stand for is added.
        """
        shared, own = (
            np.concatenate([t.columns[:, places] for t in self.trials]) for places in (slice(self.p), self.p)
        )
        carried = np.linalg.lstsq(shared, own, rcond=1e-9)[0]
        variance_of_mean = 1.0 / self.precision[self.p] / len(self.trials)
        return np.asarray(self._inverse[: self.p, : self.p] + variance_of_mean * np.outer(carried, carried))

    @cached_property
    def rank(self) -> int:
        """Directions among the positions that the data see, all other parameters projected out."""
        inside = np.arange(2, self.p)
        if not inside.size:
            return 0
        outside = np.setdiff1d(np.arange(self.precision.size), inside)
        cross = self.curvature[np.ix_(inside, outside)]
        rest = self.curvature[np.ix_(outside, outside)] + 1e-9 * np.eye(outside.size)
        left = self.curvature[np.ix_(inside, inside)] - cross @ np.linalg.solve(rest, cross.T)
        free = _free([places - 2 for places in self.held], np.ones(inside.size))
        return max(
            1, int((np.linalg.eigvalsh(free.T @ left @ free) > POLICY.evidence.seen_information).sum())
        )

    def loosest(self) -> Array | None:
        """One standard deviation (P,) along the positions' least certain direction, all others following.

        None where there is no such direction.
        """
        places = np.arange(2, self.p)
        spread = self._inverse[np.ix_(places, places)]
        size = np.sqrt(np.diag(spread))
        if not places.size or not np.all(size > 0.0):
            return None
        variances, directions = np.linalg.eigh(spread / np.outer(size, size))
        along = np.sqrt(max(variances[-1], 0.0)) * size * directions[:, -1]
        return np.asarray(self._inverse[:, places] @ np.linalg.lstsq(spread, along, rcond=1e-12)[0])

    @cached_property
    def information(self) -> tuple[Array, ...]:
        """What each trial tells of the shared parameters (s, s), its own friction profiled out."""
        return tuple(t.information() for t in self.trials)

    def without(self, group: Sequence[int]) -> tuple[Array, Array]:
        """Curvature and covariance (s, s) of the shared parameters without a group of trials.

        What the rest does not see (friction against the depth of tissue) has no variance: it does not move.
        """
        whole = sum(self.information) + np.diag(self.precision[self.shared])
        left = whole - sum(self.information[t] for t in group)
        size = np.sqrt(np.diag(left))
        alike = left / np.outer(size, size)
        free = _free(self.held, size)
        seen = np.linalg.pinv(free.T @ alike @ free, rcond=UNSEEN, hermitian=True)
        return left, free @ seen @ free.T / np.outer(size, size)

    @cached_property
    def projection(self) -> Projection:
        """What the parameters cannot make, of whitened values."""
        return Projection(self)


class Projection:
    """Projects the parameters of a linearised fit out of whitened vectors (Frisch–Waugh–Lovell theorem).

    `missed` is what the fit leaves, with the pulls on its parameters as rows of their own: an effect may be
    seen by nothing but what it relieves them of. `means` (m, N) takes the values of all trials to m
    independent ones of unit variance, which then stand in their place.
    """

    def __init__(self, fit: LinearisedFit, means: Array | None = None) -> None:
        columns, residuals = fit.columns, fit.residuals
        if means is not None:
            columns, residuals = means @ columns, means @ residuals
        self._tight = np.sqrt(fit.precision)
        self.size = residuals.size
        self._own = self.size + fit.own
        matrix = np.vstack([columns, np.diag(self._tight)]) @ _free(fit.held, np.ones_like(fit.precision))
        self._basis, _ = np.linalg.qr(matrix)
        self._own_tight = self._tight[fit.own]
        left = np.r_[residuals, -self._tight * fit.from_centre]
        self.missed: Array = left - self._basis @ (self._basis.T @ left)

    def __call__(self, vectors: Array, own: Array | None = None) -> Array:
        """(n,) or (n, m) over all trials to what the fit's parameters cannot make; n becomes longer.

        `own` (T,) is what goes with it of the trials' own friction, of which their prior tells.
        """
        padded = np.zeros((self._basis.shape[0], *vectors.shape[1:]))
        padded[: self.size] = vectors
        if own is not None:
            padded[self._own] = own * self._own_tight
        return np.asarray(padded - self._basis @ (self._basis.T @ padded))

    def rigidity(self) -> Array:
        """The direction (n longer, as above) in which the stated rigidity stands against the data."""
        row = self.size + 1
        stated = -self._basis @ self._basis[row]
        stated[row] += 1.0
        return np.asarray(stated)


def prediction_covariance(covariance: Array, own_variance: float, columns: Array) -> Array:
    """Covariance (n, n) of n values of a trial not seen yet, from that of p shared parameters (p, p).

    `columns` (n, p + 1) are its derivatives, by its own friction last.
    """
    shared, own = columns[:, :-1], columns[:, -1]
    return np.asarray(shared @ covariance @ shared.T + own_variance * np.outer(own, own))


def _free(held: Sequence[Array], size: Array) -> Array:
    """Orthonormal directions (m, ≤ m) of m parameters, in units of 1 / `size`, that change no held mean."""
    if not held:
        return np.eye(size.size)
    rows = np.zeros((len(held), size.size))
    for row, places in zip(rows, held, strict=True):
        row[places] = 1.0 / size[places]
    return np.asarray(null_space(rows))
