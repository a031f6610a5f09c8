"""Cross-validation: every command is left out in turn and predicted by a fit to the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.estimation.linear import UNSEEN, LinearisedFit
from needle_rig.workbench.estimation.map_fit import EXCESS_TOLERANCE
from needle_rig.workbench.estimation.posterior import MOST_SOLVES, excess
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem

NEAR = 1.0
"""Steps of less than one standard deviation are taken as the derivatives say, without looking."""
MOST_STEPS = 8
SHORTER = 0.3
"""Factor of a step that did not lower χ²."""
SETTLED = 0.05
"""A trial's friction is estimated until the next step would lower χ² by less than this."""
MOST_ESTIMATES = 8
FRICTION_REACH, RIGIDITY_REACH = 1.0, 0.3
"""How far leaving a command out may move their logarithms: a factor of 2.7 and of 1.35."""
RIGIDITY = 1
"""Its place among the shared parameters."""
FARTHEST = 1.2
"""Largest logarithm of a trial's friction over the common one."""


@dataclass(frozen=True)
class CrossValidation:
    """Every trial predicted by a fit to the trials of other commands."""

    error: float
    """Root mean square over all bins, in units of the noise (trial scatter included): 1 is the floor."""
    loss: float
    """−2 log predictive density of all commands and of the stated rigidity, each given the others, up to a
    constant."""
    residuals: tuple[Array, ...]
    """Data minus prediction in bin means (C, K), with the friction that the other trials share."""


def cross_validate(problem: Problem, fit: Fit) -> CrossValidation:
    """Leave every command out in turn, refit the parameters to the rest, and predict what was left out.

    A held-out trial is simulated at the refitted parameters. Its random effect is unknown and marginalised;
    in the predictive density the parameters are marginalised, too. The stated rigidity is left out in its
    turn. Infinite where there is one command only, or the model cannot be solved.
    """
    nothing = CrossValidation(float("inf"), float("inf"), (np.zeros((0, 0)),) * len(problem.trials))
    if len(problem.groups) <= 1:
        return nothing
    try:
        return _LeaveOut(problem, fit).every_command()
    except (SolverError, BadInput):
        return nothing


@dataclass(frozen=True)
class _RandomEffect:
    """A trial's log friction `at`, with whitened residuals (n,) and minus their derivative by it (n,)."""

    at: float
    residuals: Array
    slope: Array
    precision: float
    """Prior precision of `at`."""

    @property
    def chi2(self) -> float:
        return float(self.residuals @ self.residuals) + self.precision * self.at**2

    def step(self) -> tuple[float, float]:
        """The Gauss–Newton step, and the fall of χ² that it predicts."""
        stiff = float(self.slope @ self.slope) + self.precision
        toward = float(self.slope @ self.residuals) - self.precision * self.at
        return toward / stiff, toward**2 / stiff


class _LeaveOut:
    """Fits to all commands but one and their predictions of that one, from the fit to all."""

    def __init__(self, problem: Problem, fit: Fit) -> None:
        self.problem, self.fit = problem, fit
        self.linear = LinearisedFit.of(problem, fit)
        self.p, self.terms = self.linear.p, self.linear.trials
        self.random_effect_precision = fit.scatter**-2
        free = np.full(fit.nuisance.size, np.inf)
        self.prior = self.linear.precision[self.linear.shared]
        self.centre = np.zeros(self.prior.size)
        self.centre[1] = float(np.log(problem.base.torsional_rigidity_nm2))
        vector = fit.vector
        self.at = np.r_[vector.log_friction, vector.log_rigidity, vector.scaled_values, fit.nuisance]
        reach = np.array([FRICTION_REACH, RIGIDITY_REACH])
        self.low = np.r_[self.at[:2] - reach, [a.bounds[0] for a in fit.parameters], -free]
        self.high = np.r_[self.at[:2] + reach, [a.bounds[1] for a in fit.parameters], free]
        fixed = list(problem.fixed_places(fit.parameters, vector.scaled_values))
        for ends in (self.centre, self.low, self.high):
            ends[fixed] = self.at[fixed]

    def every_command(self) -> CrossValidation:
        """Each command left out. Raises SolverError, BadInput."""
        problem, groups = self.problem, self.problem.groups
        left, information = [self._without(group) for group in groups], self.linear.information
        place = {t: x for group, (x, _) in zip(groups, left, strict=True) for t in group}
        order = sorted(place)
        common = problem.readings(self._models(place, order), order, most_solves=MOST_SOLVES)
        random_effects = self._random_effects(place)
        chi2 = sum(o.chi2 for o in random_effects.values())
        loss = chi2 + sum(float(np.log(t.stiffness / t.random_effect_precision)) for t in self.terms)
        for group, (_, spread) in zip(groups, left, strict=True):
            push = sum(self.terms[t].push(random_effects[t].residuals, random_effects[t].at) for t in group)
            inner = np.eye(len(spread)) + spread @ sum(information[t] for t in group)
            loss += float(np.linalg.slogdet(inner)[1] - push @ np.linalg.solve(inner, spread @ push))
        loss += self._stated_rigidity()
        residuals = tuple(problem.trials[t].mean - r for t, r in zip(order, common, strict=True))
        return CrossValidation(float(np.sqrt(chi2 / problem.size)), loss, residuals)

    def _stated_rigidity(self) -> float:
        """−2 log predictive density of the stated rigidity, given all commands, up to a constant.

        With its leverage h, the share that it has in its own estimate, a stated value which the fit misses
        by z standard deviations was predicted with an error of z²/(1 − h) (Cook, Weisberg 1982, 2.2.3).
        """
        if RIGIDITY in self.linear.fixed:
            return 0.0
        _, spread = self.linear.without(())
        apart = max(1.0 - float(spread[RIGIDITY, RIGIDITY] * self.prior[RIGIDITY]), UNSEEN)
        return self.fit.pull_rigidity**2 / apart - float(np.log(apart))

    def _without(self, group: Sequence[int]) -> tuple[Array, Array]:
        """(shared parameters (s,) fitted without a group of trials, their covariance (s, s)).

        Gauss–Newton with the derivatives of the fit to all; a step that does not lower χ² is shortened.
        """
        left, spread = self.linear.without(group)
        terms = {t: terms for t, terms in enumerate(self.terms) if t not in group}
        x, friction = self.at, {t: float(self.fit.vector.trial_friction[t]) for t in terms}
        residuals = {t: self.fit.residuals[t] for t in terms}
        value = self._chi2(x, friction, residuals)
        near, share = NEAR + EXCESS_TOLERANCE * excess(self.problem, self.fit.objective), 1.0
        for _ in range(MOST_STEPS):
            push = sum(terms[t].push(residuals[t], friction[t]) for t in terms) - self.prior * (
                x - self.centre
            )
            step = np.clip(x + share * spread @ push, self.low, self.high) - x
            after = x + step
            if float(step @ left @ step) < near:
                return after, spread
            moved = {}
            for t, at in friction.items():
                further = terms[t].random_effect_step(residuals[t] - terms[t].shared @ step, at)
                moved[t] = float(np.clip(at + further, -FARTHEST, FARTHEST))
            after_residuals = self._residuals(dict.fromkeys(terms, after), moved)
            after_value = self._chi2(after, moved, after_residuals)
            if after_value < value:
                x, friction, residuals, value = after, moved, after_residuals, after_value
            else:
                share *= SHORTER
        return x, spread

    def _random_effects(self, place: Mapping[int, Array]) -> dict[int, _RandomEffect]:
        """Each trial's friction fitted to its data at given shared parameters, by the secant method."""
        begin = {t: float(self.fit.vector.trial_friction[t]) for t in place}
        residuals = self._residuals(place, begin)
        best = {
            t: _RandomEffect(at, residuals[t], self.terms[t].random_effect, self.random_effect_precision)
            for t, at in begin.items()
        }
        for _ in range(MOST_ESTIMATES):
            further = {}
            for t, effect in best.items():
                step, worth = effect.step()
                at = float(np.clip(effect.at + step, -FARTHEST, FARTHEST))
                if worth > SETTLED and at != effect.at:
                    further[t] = at
            if not further:
                break
            for t, after in self._residuals(place, further).items():
                old, at = best[t], further[t]
                slope = (old.residuals - after) / (at - old.at)
                new = _RandomEffect(at, after, slope, self.random_effect_precision)
                best[t] = new if new.chi2 < old.chi2 else dataclasses.replace(old, slope=slope)
        return best

    def _model(self, x: Array) -> NeedleModel:
        """The model at shared parameters x (s,), with the friction that all trials share."""
        vector = ParameterVector(float(x[0]), float(x[1]), x[2 : self.p], np.zeros(0))
        return self.problem.model(self.fit.parameters, vector)

    def _models(self, place: Mapping[int, Array], trials: Sequence[int]) -> list[NeedleModel]:
        """The model of each trial: one object where shared parameters are one."""
        made = {id(place[t]): self._model(place[t]) for t in trials}
        return [made[id(place[t])] for t in trials]

    def _residuals(self, place: Mapping[int, Array], friction: Mapping[int, float]) -> dict[int, Array]:
        """Whitened residuals of the trials in `friction`, each at its shared parameters and log friction."""
        order = list(friction)
        factors = np.exp([friction[t] for t in order])
        readings = self.problem.readings(self._models(place, order), order, factors, MOST_SOLVES)
        residuals = self.problem.residuals(readings, order)
        nuisance = self.problem.nuisance
        return {t: r - nuisance[t] @ place[t][self.p :] for t, r in zip(order, residuals, strict=True)}

    def _chi2(self, x: Array, friction: Mapping[int, float], residuals: Mapping[int, Array]) -> float:
        parts = sum(
            float(r @ r) + self.random_effect_precision * friction[t] ** 2 for t, r in residuals.items()
        )
        return parts + float(self.prior @ (x - self.centre) ** 2)
