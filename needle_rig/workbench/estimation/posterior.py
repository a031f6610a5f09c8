"""What a fit minimises: −2 log of the posterior over one vector of parameters, and its derivatives.

Whitened residuals, priors as rows, and each trial's own friction as a random effect whose scatter is
integrated out (Student-t logarithms: a large scatter is paid for once, not for every trial). Derivatives are
finite differences of 0.3 % of a typical size, taken about each trial's own friction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.derivatives import directional_derivatives
from needle_rig.workbench.estimation.parameters import Coordinate, held_means
from needle_rig.workbench.estimation.problem import Point, Problem
from needle_rig.workbench.policy import POLICY

STEP = 0.003
MOST_SOLVES = 150.0
"""Solves a sample beyond which a fit does not go: a needle that snaps from balance to balance, whose instants
no derivative follows. Ageing friction takes about ten, most effects one or two."""
LEVEL = 1e6
"""Weight that holds the mean of the trials' own friction at 0: the friction of all is their common level; and
that of items which count against their mean. Without it the two trade places along a direction that the data
do not see, damped steps creep, and the derivatives' errors pass for knowledge."""


def start_point(problem: Problem, log_friction: float, axes: Sequence[Coordinate] = ()) -> Point:
    """Everything at its stated value or off."""
    return Point(
        log_friction=log_friction,
        log_rigidity=float(np.log(problem.base.torsional_rigidity_nm2)),
        positions=np.zeros(len(axes)),
        trial_friction=np.zeros(len(problem.trials)),
    )


class Objective:
    """What is minimised over one vector of parameters: rows, prior and derivatives.

    The vector is friction and rigidity (logarithms), k positions, T trials' own friction, q nuisances.
    """

    def __init__(self, problem: Problem, axes: tuple[Coordinate, ...]) -> None:
        self.problem, self.axes = problem, axes
        self.k, self.trials = len(axes), len(problem.trials)
        self.q = problem.nuisance[0].shape[1]
        self.p = 2 + self.k
        self.own = self.p if problem.lumps_friction(axes) else 0
        """Column of the derivatives for the trials' own friction: that of friction, unless some is lumped."""
        self.width = np.array([a.width for a in axes])
        self.means = [2 + places for places in held_means(axes)]
        self.stated = float(np.log(problem.base.torsional_rigidity_nm2))
        low = [a.bounds[0] for a in axes]
        high = [a.bounds[1] for a in axes]
        own, free = np.full(self.trials, 1.2), np.full(self.q, 8.0)
        self.low = np.r_[np.log(1e-7), self.stated - 1.5, low, -own, -free]
        self.high = np.r_[np.log(0.045), self.stated + 1.5, high, own, free]

    def point(self, x: Array) -> Point:
        """The vector without its nuisances."""
        return Point(float(x[0]), float(x[1]), x[2 : self.p], x[self.p : self.p + self.trials])

    def vector(self, point: Point, nuisance: Array) -> Array:
        """A point and its nuisances (q,) within bounds, with every mean that is held at its place."""
        own = point.trial_friction
        common = point.log_friction + own.mean()
        x = np.r_[common, point.log_rigidity, point.positions, own - own.mean(), nuisance]
        for places in self.means:
            x[places] -= x[places].mean()
        return np.asarray(np.clip(x, self.low, self.high), dtype=np.float64)

    def rows(self, x: Array) -> list[Array] | None:
        """Whitened data minus model (n,) a trial, None where the model cannot be solved."""
        try:
            readings = self.problem.predict(self.axes, self.point(x), MOST_SOLVES)
        except (SolverError, BadInput):
            return None
        rows = self.problem.residuals(readings, range(self.trials))
        found = [r - n @ x[self.p + self.trials :] for r, n in zip(rows, self.problem.nuisance, strict=True)]
        return found if all(np.all(np.isfinite(r)) for r in found) else None

    def prior(self, x: Array) -> float:
        """−2 log prior, up to a constant."""
        noise = self.problem.noise
        own = x[self.p : self.p + self.trials]
        room = noise.scatter_dof * noise.scatter**2
        return float(
            ((x[1] - self.stated) / self.problem.rigidity_prior) ** 2
            + ((x[2 : self.p] / self.width) ** 2).sum()
            + (noise.scatter_dof + self.trials) * np.log1p((own**2).sum() / room)
            + LEVEL * (own.mean() ** 2 + sum(x[places].mean() ** 2 for places in self.means))
            + (x[self.p + self.trials :] ** 2).sum()
        )

    def own_precision(self, x: Array) -> float:
        """Precision of a normal prior of the trials' own friction that bounds theirs from above at `x`."""
        noise = self.problem.noise
        own = x[self.p : self.p + self.trials]
        room = noise.scatter_dof * noise.scatter**2
        return float((noise.scatter_dof + self.trials) / (room + (own**2).sum()))

    def derivatives(self, x: Array, rows: list[Array]) -> list[Array] | None:
        """Whitened model derivatives (n, p or p + 1) a trial, None where the model cannot be solved near x.

        Friction goes up and rigidity down: the angles, which depend on their ratio, then change alike to the
        last bit, and what only the needle's stated constants tell is not told by the steps' own error.
        """
        directions = np.eye(self.p, x.size)
        steps = np.r_[STEP, -STEP, STEP * np.maximum(1.0, np.abs(x[2 : self.p]))]
        if self.own == self.p:
            every_trial = np.zeros(x.size)
            every_trial[self.p : self.p + self.trials] = 1.0
            directions, steps = np.vstack([directions, every_trial]), np.r_[steps, STEP]

        def left(moved: Array) -> Array | None:
            after = self.rows(moved)
            return None if after is None else np.concatenate(after)

        jacobian = directional_derivatives(
            left, x, np.concatenate(rows), directions, steps, self.low, self.high
        )
        if jacobian is None:
            return None
        return np.split(-jacobian, np.cumsum([r.size for r in rows])[:-1])


def excess(problem: Problem, value: float) -> float:
    """How far an objective lies above what noise alone explains."""
    size = problem.size
    return max(0.0, value - size - POLICY.search.above_noise_sigmas * float(np.sqrt(2.0 * size)))


def sum_of_squares(rows: Sequence[Array]) -> float:
    """χ² of whitened rows."""
    return float(sum(r @ r for r in rows))
