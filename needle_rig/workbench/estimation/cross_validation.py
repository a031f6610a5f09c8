"""How well a fit foretells commands that it has not seen."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.map_fit import LOOSE, Fit
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Point, Problem

NEAR = 1.0
"""Steps of less than one standard deviation are taken as the derivatives say, without looking."""
MOST_STEPS = 8
SETTLED = 0.05
"""A trial's own friction is estimated until the next step would lower χ² by less than this."""
MOST_ESTIMATES = 8
FARTHEST = 1.2
"""Largest logarithm of a trial's own friction."""


@dataclass(frozen=True)
class HeldOut:
    """Prediction of every trial by a fit to the trials of other commands."""

    error: float
    """Root mean square over all bins, in units of the noise (trial scatter included): 1 is the floor."""
    loss: float
    """−2 log predictive density of all commands, each given the others, up to a constant."""
    residuals: tuple[Array, ...]
    """Data minus prediction in bin means (C, K), with the friction that the other trials share."""


def held_out(problem: Problem, fit: Fit) -> HeldOut:
    """Leave every command out in turn; parameters move to where the rest puts them.

    A held-out trial is then simulated afresh; its own friction is unknown and integrated out, and in the
    predictive density so are the parameters, as far as the rest leaves them uncertain. Infinite where there
    is one command only, or the model cannot be solved.
    """
    nothing = HeldOut(float("inf"), float("inf"), (np.zeros((0, 0)),) * len(problem.trials))
    if len(problem.groups) < 2:
        return nothing
    try:
        return _LeaveOut(problem, fit).every_command()
    except (SolverError, BadInput):
        return nothing


@dataclass(frozen=True)
class _Own:
    """A trial at own friction `at`: whitened residuals (n,), and how they fall with it (n,)."""

    at: float
    rows: Array
    slope: Array
    precision: float
    """Of its prior."""

    @property
    def chi2(self) -> float:
        return float(self.rows @ self.rows) + self.precision * self.at**2

    def step(self) -> tuple[float, float]:
        """The next step, and what χ² should fall by."""
        stiff = float(self.slope @ self.slope) + self.precision
        toward = float(self.slope @ self.rows) - self.precision * self.at
        return toward / stiff, toward**2 / stiff


class _LeaveOut:
    """Fits to all trials but some, and what these foretell of the others, from the fit to all."""

    def __init__(self, problem: Problem, fit: Fit) -> None:
        self.problem, self.fit = problem, fit
        self.linear = LinearisedFit.of(problem, fit)
        self.p, self.told = self.linear.p, self.linear.trials
        self.own_precision = fit.scatter**-2
        free = np.full(fit.nuisance.size, np.inf)
        self.prior = self.linear.precision[self.linear.shared]
        self.centre = np.zeros(self.prior.size)
        self.centre[1] = float(np.log(problem.base.torsional_rigidity_nm2))
        point = fit.point
        self.at = np.r_[point.log_friction, point.log_rigidity, point.positions, fit.nuisance]
        reach = np.array([1.0, 0.3])
        self.low = np.r_[self.at[:2] - reach, [a.bounds[0] for a in fit.axes], -free]
        self.high = np.r_[self.at[:2] + reach, [a.bounds[1] for a in fit.axes], free]

    def every_command(self) -> HeldOut:
        """Each command left out. Raises SolverError, BadInput."""
        problem, groups = self.problem, self.problem.groups
        left, information = [self._without(group) for group in groups], self.linear.information
        place = {t: x for group, (x, _) in zip(groups, left, strict=True) for t in group}
        order = sorted(place)
        common = problem.readings([self._model(place[t]) for t in order], order)
        own = self._own_friction(place)
        chi2 = sum(o.chi2 for o in own.values())
        loss = chi2 + sum(float(np.log(t.stiffness / t.own_precision)) for t in self.told)
        for group, (_, spread) in zip(groups, left, strict=True):
            push = sum(self.told[t].push(own[t].rows, own[t].at) for t in group)
            inner = np.eye(len(spread)) + spread @ sum(information[t] for t in group)
            loss += float(np.linalg.slogdet(inner)[1] - push @ np.linalg.solve(inner, spread @ push))
        residuals = tuple(problem.trials[t].mean - r for t, r in zip(order, common, strict=True))
        return HeldOut(float(np.sqrt(chi2 / problem.size)), loss, residuals)

    def _without(self, group: Sequence[int]) -> tuple[Array, Array]:
        """(shared parameters that the other trials prefer (s,), their covariance (s, s)).

        Steps keep the derivatives of the fit to all; they are shortened where they do not lower χ².
        """
        left, spread = self.linear.without(group)
        told = {t: told for t, told in enumerate(self.told) if t not in group}
        x, own = self.at, {t: float(self.fit.point.trial_friction[t]) for t in told}
        rows = {t: self.fit.residuals[t] for t in told}
        value = self._chi2(x, own, rows)
        near, share = NEAR + LOOSE * excess(self.problem, self.fit.objective), 1.0
        for _ in range(MOST_STEPS):
            push = sum(told[t].push(rows[t], own[t]) for t in told) - self.prior * (x - self.centre)
            step = np.clip(x + share * spread @ push, self.low, self.high) - x
            after = x + step
            if float(step @ left @ step) < near:
                return after, spread
            moved = {t: own[t] + told[t].own_step(rows[t] - told[t].shared @ step, own[t]) for t in told}
            after_rows = self._rows(dict.fromkeys(told, after), moved)
            after_value = self._chi2(after, moved, after_rows)
            if after_value < value:
                x, own, rows, value = after, moved, after_rows, after_value
            else:
                share *= 0.3
        return x, spread

    def _own_friction(self, place: Mapping[int, Array]) -> dict[int, _Own]:
        """Each trial at its shared parameters, at the own friction that its data prefer, found by secants."""
        begin = {t: float(self.fit.point.trial_friction[t]) for t in place}
        rows = self._rows(place, begin)
        best = {t: _Own(at, rows[t], self.told[t].own, self.own_precision) for t, at in begin.items()}
        for _ in range(MOST_ESTIMATES):
            further = {}
            for t, own in best.items():
                step, worth = own.step()
                at = float(np.clip(own.at + step, -FARTHEST, FARTHEST))
                if worth > SETTLED and at != own.at:
                    further[t] = at
            if not further:
                break
            for t, after in self._rows(place, further).items():
                old, at = best[t], further[t]
                slope = (old.rows - after) / (at - old.at)
                new = _Own(at, after, slope, self.own_precision)
                best[t] = new if new.chi2 < old.chi2 else dataclasses.replace(old, slope=slope)
        return best

    def _model(self, x: Array) -> NeedleModel:
        """With the friction that all trials share."""
        point = Point(float(x[0]), float(x[1]), x[2 : self.p], np.zeros(0))
        return self.problem.model(self.fit.axes, point)

    def _rows(self, place: Mapping[int, Array], own: Mapping[int, float]) -> dict[int, Array]:
        """Whitened residuals of the trials in `own`, each at its shared parameters and own friction."""
        order = list(own)
        models = [self._model(place[t]).with_effects(FrictionOfTrial(float(np.exp(own[t])))) for t in order]
        rows = self.problem.residuals(self.problem.readings(models, order), order)
        nuisance = self.problem.nuisance
        return {t: r - nuisance[t] @ place[t][self.p :] for t, r in zip(order, rows, strict=True)}

    def _chi2(self, x: Array, own: Mapping[int, float], rows: Mapping[int, Array]) -> float:
        parts = sum(float(r @ r) + self.own_precision * own[t] ** 2 for t, r in rows.items())
        return parts + float(self.prior @ (x - self.centre) ** 2)
