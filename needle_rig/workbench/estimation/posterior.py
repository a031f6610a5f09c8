"""The objective function of fits, −2 log posterior, and its derivatives.

Whitened residuals, Gaussian priors, and each trial's friction as a random effect whose scatter is
marginalised (a multivariate Student t: a large scatter is paid for once, not for every trial). Derivatives
are those of the solver's tangent, or finite differences of 0.3 % of a typical size, taken at each trial's
random effect.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Container, Sequence
from functools import partial

import numpy as np

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.derivatives import directional_derivatives
from needle_rig.workbench.estimation.parameters import FreeParameter, constrained_means
from needle_rig.workbench.estimation.problem import ParameterVector, Problem
from needle_rig.workbench.estimation.slip_limits import log_slip_limits
from needle_rig.workbench.policy import POLICY

STEP = 0.003
MOST_SOLVES = 150.0
"""Solves a sample beyond which a fit does not go: a needle that snaps from balance to balance, whose instants
no derivative follows. Ageing friction takes about ten, most effects one or two."""
LEVEL = 1e6
"""Weight of the sum-to-zero constraints: on the random effects, whose mean is the common friction, and on
items of an effect with a constrained mean. Without them the common value and the mean are not identifiable:
damped steps creep, and errors of the derivatives pass for information."""
FIXED_LEVEL = 1e10
"""The same where the common friction is fixed: a shift of the random effects would stand for it, and the data
know it to some 1e-4, which is a curvature of 1e8."""

MOST_TRIAL_FRICTION = 1.2
"""Bound of a random effect: a friction 3.3 times the common one."""
MOST_NUISANCE = 8.0
"""Bound of a nuisance coefficient, in prior standard deviations."""
FRICTION_BOUNDS_N = (1e-7, 0.045)
"""Bounds of friction: none that a sensor sees, and twenty times the shipped needles' most."""
MOST_RIGIDITY, MOST_SIGMAS = 1.5, 3.0
"""Bound of the logarithm of rigidity over the stated one: a factor of 4.5, or so many prior standard
deviations where it is known less well."""


def start_vector(
    problem: Problem, log_friction: float, parameters: Sequence[FreeParameter] = ()
) -> ParameterVector:
    """The parameter vector with everything at its stated value or off."""
    return ParameterVector(
        log_friction=log_friction,
        log_rigidity=float(np.log(problem.base.torsional_rigidity_nm2)),
        scaled_values=np.zeros(len(parameters)),
        trial_friction=np.zeros(len(problem.trials)),
    )


class Objective:
    """The objective function, −2 log posterior: residuals, prior and derivatives at a vector x (P,).

    x holds friction and rigidity (logarithms), k scaled values, T random effects, q nuisances.
    """

    def __init__(self, problem: Problem, parameters: tuple[FreeParameter, ...], scaled_values: Array) -> None:
        """`scaled_values` (k,) are those of what a fit holds; the others there count for nothing."""
        self.problem, self.parameters = problem, parameters
        self.k, self.trials = len(parameters), len(problem.trials)
        self.recorded, self.blocks = problem.recorded, np.bincount(problem.recorded)
        self.q = problem.nuisance[0].shape[1]
        self.p = 2 + self.k
        self.random_effect_column = self.p if problem.lumps_friction(parameters) else 0
        """Column of the derivatives by a trial's random effect: that of friction, unless some friction is
        lumped."""
        self.prior_sd = np.array([a.prior_sd for a in parameters])
        self.constrained_means = [2 + places for places in constrained_means(parameters)]
        self.stated = float(np.log(problem.base.torsional_rigidity_nm2))
        reach = max(MOST_RIGIDITY, MOST_SIGMAS * problem.rigidity_prior)
        low = [a.bounds[0] for a in parameters]
        high = [a.bounds[1] for a in parameters]
        trial_friction, free = np.full(self.trials, MOST_TRIAL_FRICTION), np.full(self.q, MOST_NUISANCE)
        least, most = np.log(np.multiply(self.problem.base.torque_scale, FRICTION_BOUNDS_N))
        self.low = np.r_[least, self.stated - reach, low, -trial_friction, -free]
        self.high = np.r_[most, self.stated + reach, high, trial_friction, free]
        self.fixed = problem.fixed_places(parameters, scaled_values)
        self.held = np.array([a.held for a in parameters], bool)
        for place, value in self.fixed.items():
            self.low[place] = self.high[place] = value

    def unpacked(self, x: Array) -> ParameterVector:
        """The parameter vector in x, without the nuisances."""
        return ParameterVector(float(x[0]), float(x[1]), x[2 : self.p], x[self.p : self.p + self.trials])

    def packed(self, vector: ParameterVector, nuisance: Array) -> Array:
        """x from a parameter vector and nuisances (q,), within bounds, with every constraint on a mean
        met."""
        trial_friction = vector.trial_friction
        common = vector.log_friction + trial_friction.mean()
        x = np.r_[
            common,
            vector.log_rigidity,
            vector.scaled_values,
            trial_friction - trial_friction.mean(),
            nuisance,
        ]
        for places in self.constrained_means:
            x[places] -= x[places].mean()
        return np.asarray(np.clip(x, self.low, self.high), dtype=np.float64)

    def residuals(self, x: Array) -> list[Array] | None:
        """Whitened data minus model (n,) a trial, None where the model cannot be solved."""
        try:
            readings = self.problem.predict(self.parameters, self.unpacked(x), MOST_SOLVES)
        except (SolverError, BadInput):
            return None
        return self._left(readings, x)

    def _left(self, readings: list[Array], x: Array) -> list[Array] | None:
        """Whitened data minus model (n,) a trial for the model's bin means; None unless all are finite."""
        residuals = self.problem.residuals(readings, range(self.trials))
        found = [
            r - n @ x[self.p + self.trials :] for r, n in zip(residuals, self.problem.nuisance, strict=True)
        ]
        return found if all(np.all(np.isfinite(r)) for r in found) else None

    def _near(self, x: Array, moved: Sequence[Array]) -> list[Array | None]:
        """Residuals (N,) at each of `moved`, to first order about x; None out of the tangent's reach."""
        try:
            readings = self.problem.near(
                self.parameters, self.unpacked(x), [self.unpacked(m) for m in moved], MOST_SOLVES
            )
        except (SolverError, BadInput):
            return [None] * len(moved)
        left = [None if r is None else self._left(r, m) for r, m in zip(readings, moved, strict=True)]
        return [None if each is None else np.concatenate(each) for each in left]

    def random_effects(self, x: Array) -> Array:
        """Of each recorded trial: the mean of its blocks', which differ by nothing."""
        return np.asarray(np.bincount(self.recorded, x[self.p : self.p + self.trials]) / self.blocks)

    def prior(self, x: Array) -> float:
        """−2 log prior, up to a constant."""
        noise = self.problem.noise
        random_effects = self.random_effects(x)
        apart = x[self.p : self.p + self.trials] - random_effects[self.recorded]
        room = noise.scatter_dof * noise.scatter**2
        return float(
            ((x[1] - self.stated) / self.problem.rigidity_prior) ** 2
            + ((x[2 : self.p] / self.prior_sd) ** 2).sum()
            + (noise.scatter_dof + random_effects.size) * np.log1p((random_effects**2).sum() / room)
            + level(self.fixed)
            * (
                x[self.p : self.p + self.trials].mean() ** 2
                + (apart**2).sum()
                + sum(x[places].mean() ** 2 for places in self.constrained_means)
            )
            + (x[self.p + self.trials :] ** 2).sum()
        )

    def random_effect_precision(self, x: Array) -> float:
        """Precision of the normal prior of the random effects that majorises −2 log of their prior at `x`."""
        noise = self.problem.noise
        random_effects = self.random_effects(x)
        room = noise.scatter_dof * noise.scatter**2
        return float((noise.scatter_dof + random_effects.size) / (room + (random_effects**2).sum()))

    def derivatives(self, x: Array, residuals: list[Array]) -> list[Array] | None:
        """Whitened model derivatives (n, p or p + 1) a trial, None where the model cannot be solved near x.

        By the solver's tangent where it reaches, else by solving again. Friction is stepped up and rigidity
        down: the angles depend on their ratio, so both columns are then alike, and truncation error does not
        pass for information that only the stated rigidity has. An effect is stepped at the same slip limits
        of each trial, and the share of friction in it is added by friction's own derivative: both are then
        alike where the effect is nothing but friction.
        """
        moving = np.r_[True, True, ~self.held]
        directions = np.eye(self.p, x.size)[moving]
        steps = np.r_[STEP, -STEP, STEP * np.maximum(1.0, np.abs(x[2 : self.p]))][moving]
        if self.random_effect_column == self.p:
            every_trial = np.zeros(x.size)
            every_trial[self.p : self.p + self.trials] = 1.0
            directions, steps = np.vstack([directions, every_trial]), np.r_[steps, STEP]

        shares = self._friction_shares(x)
        directions[:, self.p : self.p + self.trials] -= directions[:, : self.p] @ shares.T

        def left(moved: Array) -> Array | None:
            after = self.residuals(moved)
            return None if after is None else np.concatenate(after)

        here = np.concatenate(residuals)
        near = partial(self._near, x)
        jacobian = directional_derivatives(left, x, here, directions, steps, self.low, self.high, near)
        if jacobian is None:
            return None
        random_effect = jacobian[:, -1] if self.random_effect_column else jacobian[:, 0]
        trial_of_row = np.repeat(np.arange(self.trials), [r.size for r in residuals])
        jacobian[:, : moving.sum()] += random_effect[:, None] * shares[trial_of_row][:, moving]
        if not moving.all():
            # what is held has no column of its own: nothing is known of its slope, and nothing is asked
            jacobian = np.insert(jacobian, np.flatnonzero(~moving) - np.arange((~moving).sum()), 0.0, axis=1)
        return np.split(-jacobian, np.cumsum([r.size for r in residuals])[:-1])

    def _friction_shares(self, x: Array) -> Array:
        """Change of the logarithm of each trial's slip limits (T, p) with the effects that shape friction."""
        shares = np.zeros((self.trials, self.p))
        library, vector = self.problem.library, self.unpacked(x)
        shaping = [i for i, a in enumerate(self.parameters) if not a.held and library[a.effect].has("shape")]
        if not shaping:
            return shares
        before = log_slip_limits(self.problem, self.parameters, vector)
        for i in shaping:
            step = STEP * max(1.0, abs(vector.scaled_values[i]))
            step = step if vector.scaled_values[i] + step <= self.parameters[i].bounds[1] else -step
            moved = vector.scaled_values.copy()
            moved[i] += step
            after = dataclasses.replace(vector, scaled_values=moved)
            change = log_slip_limits(self.problem, self.parameters, after) - before
            shares[:, 2 + i] = np.nan_to_num(change) / step
        return shares


def level(fixed: Container[int]) -> float:
    """Weight of the sum-to-zero constraints, where the shared parameters at places `fixed` do not move."""
    return FIXED_LEVEL if 0 in fixed else LEVEL


def excess(problem: Problem, value: float) -> float:
    """How far an objective lies above what noise alone explains."""
    size = problem.size
    return max(0.0, value - size - POLICY.evidence.clear_sigmas * float(np.sqrt(2.0 * size)))


def sum_of_squares(residuals: Sequence[Array]) -> float:
    """χ² of whitened rows."""
    return float(sum(r @ r for r in residuals))
