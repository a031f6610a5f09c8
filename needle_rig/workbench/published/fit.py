"""Fits to settled values, with the strategy's own loop run on the model.

The loop belongs to it: the strategy's waypoints follow the torque that the model's sensor shows. Minimised
are squared rows: values in units of their standard errors, the stated torsional rigidity, and each effect's
parameters, whose plausible range (in the effect's file) is read as 95 % from off to its edge.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from needle_rig.control.strategy import History, Strategy, Task, make_strategy
from needle_rig.dataset.settled import Seen, SettledData, SettledValue
from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array, forward_jacobian
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.units import deg, nmm, rad
from needle_rig.workbench.estimation.parameters import FreeParameter, free_parameters, make_effects
from needle_rig.workbench.selection.answer import SIGMAS_95
from needle_rig.workbench.virtual.noise import NO_NOISE
from needle_rig.workbench.virtual.settled_run import Recorded, run_settled

STEP = 0.01
"""Step of finite differences: 1 % of friction, rigidity or a typical size; with less, dry friction is
jagged."""
FRICTIONS_N = (2e-4, 4e-4, 7e-4, 1e-3, 1.6e-3, 3e-3)
STRENGTHS = (-3.0, -1.0, -0.3, 0.3, 1.0, 3.0)
FURTHER = 3
"""How many of the starts are followed to their minimum."""
MOST_EVALUATIONS = 40
FAR = 1e3
"""Residual where the model cannot be solved."""


def pull(parameter: FreeParameter, scaled_value: float) -> float:
    """How far a scaled value lies towards the edge of the plausible range, in σ; the edge itself is 1.96."""
    if parameter.info.shapes:
        return scaled_value / parameter.prior_sd
    edges = [parameter.scaled_value(v) for v in parameter.info.literature]
    same = [e for e in edges if e * scaled_value > 0]
    edge = max(map(abs, same)) if same else STEP * max(map(abs, edges))
    return SIGMAS_95 * scaled_value / edge


@dataclass(frozen=True)
class SettledProblem:
    """Settled values, the model that predicts them, and the sequences that it runs."""

    data: SettledData
    base: NeedleModel
    """Geometry and stated constants, without effects."""
    library: Mapping[str, type[Effect]]
    values: tuple[SettledValue, ...]

    @cached_property
    def loops(self) -> tuple[tuple[Strategy, Task], ...]:
        """Strategy and task of each sequence. Raises BadInput with file and line."""
        found = []
        for s in self.data.sequences:
            task = Task(
                rad(s.target_deg),
                self.base.layout,
                self.data.needle.torsional_rigidity_nm2,
                rad(s.speed_deg_s),
                s.settle_s,
                model=self.base,
            )
            try:
                strategy = make_strategy(s.strategy, s.options)
                strategy.check(task)
            except BadInput as error:
                raise BadInput(f"{s.place}: {error}") from None
            found.append((Recorded(strategy, s.base_deg), task))
        return tuple(found)

    @cached_property
    def measured(self) -> Array:
        """The weighed values (n,), each in its unit."""
        return np.array([v.value for v in self.values])

    @cached_property
    def errors(self) -> Array:
        """Their standard errors (n,)."""
        return np.array([v.standard_error or np.inf for v in self.values])

    def parameters(self, names: Sequence[str]) -> tuple[FreeParameter, ...]:
        """Free parameters of the named effects."""
        return free_parameters(self.library, names, self.base.layout)

    def model(self, parameters: Sequence[FreeParameter], x: Array) -> NeedleModel:
        """The model at x: logarithms of friction (N) and of rigidity over the stated one, then scaled
        values."""
        return dataclasses.replace(
            self.base,
            friction_n=float(np.exp(x[0])),
            torsional_rigidity_nm2=self.data.needle.torsional_rigidity_nm2 * float(np.exp(x[1])),
            effects=make_effects(self.library, parameters, x[2:]),
        )

    def run(self, model: NeedleModel) -> tuple[History, ...]:
        """Every sequence on `model`. Raises SolverError, BadInput."""
        random = np.random.default_rng(0)
        zeroed = self.data.zeroed_at_rest
        return tuple(
            run_settled(model, s, task, random, NO_NOISE, zeroed=zeroed).history for s, task in self.loops
        )

    def predict(self, model: NeedleModel) -> Array:
        """The model's prediction of the weighed values (n,). Raises SolverError, BadInput."""
        runs = self.run(model)
        return np.array([self.reading(runs, v.of) for v in self.values])

    def reading(self, runs: tuple[History, ...], of: Seen) -> float:
        """One quantity of the runs, in its unit. Raises BadInput, with file and line, for no such motion."""
        history = runs[of.sequence]
        named = [m for m in history if m.name == of.motion]
        if not named:
            raise BadInput(
                f"{self.data.sequences[of.sequence].place}: the sequence has no motion {of.motion};"
                f" it has {', '.join(m.name for m in history)}"
            )
        motion = named[-1]
        hall = np.degrees(motion.hall_rad)
        if of.sensor is not None:
            return float(hall[of.sensor])
        return {
            "torque_nmm": nmm(motion.torque_nm),
            "tip_lag_deg": deg(motion.tip_lag_rad),
            "hall_mean_deg": float(hall.mean()),
            "hall_range_deg": float(np.ptp(hall)),
        }[of.quantity]


@dataclass(frozen=True)
class SettledFit:
    """A minimum. n values, p = 2 + k parameters."""

    effects: tuple[str, ...]
    parameters: tuple[FreeParameter, ...]
    x: Array
    predicted: Array
    chi2: float
    """Sum of squared residuals of the values, in units of their standard errors."""
    objective: float
    """χ² and the squared pulls of rigidity and parameters: −2 log posterior up to a constant."""
    covariance: Array
    freedom: float
    """Degrees of freedom: values less the effective number of parameters (MacKay 1992)."""
    pulls: Array
    """Pull of each scaled value towards the edge of its plausible range, in σ (k,)."""

    @property
    def p_value(self) -> float:
        """p value of χ² on `freedom` degrees of freedom; 0 when none is left."""
        return float(chdtrc(self.freedom, self.chi2)) if self.freedom > 0 else 0.0

    @property
    def error(self) -> Array:
        """Standard deviation of each scaled value (k,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance)[2:], 0.0))


class _Residuals:
    def __init__(self, problem: SettledProblem, names: Sequence[str]) -> None:
        self.problem, self.parameters = problem, problem.parameters(names)
        self.low = np.r_[math.log(1e-5), -1.5, [a.bounds[0] for a in self.parameters]]
        self.high = np.r_[math.log(0.045), 1.5, [a.bounds[1] for a in self.parameters]]
        self._at: dict[bytes, Array] = {}

    def predicted(self, x: Array) -> Array:
        key = x.tobytes()
        if key not in self._at:
            try:
                self._at[key] = self.problem.predict(self.problem.model(self.parameters, x))
            except SolverError:
                self._at[key] = np.full(len(self.problem.values), np.nan)
        return self._at[key]

    def __call__(self, x: Array) -> Array:
        data = (self.predicted(x) - self.problem.measured) / self.problem.errors
        sigma = max(self.problem.data.needle.rigidity_sigma, 1e-4)
        pulls = [pull(a, float(p)) for a, p in zip(self.parameters, x[2:], strict=True)]
        return np.concatenate([np.nan_to_num(data, nan=FAR), [x[1] / sigma], pulls])

    def jacobian(self, x: Array) -> Array:
        return forward_jacobian(self, x, self(x), STEP, self.low, self.high)


def fit_settled(
    problem: SettledProblem,
    names: Sequence[str],
    starts: Sequence[Array] | None = None,
    *,
    within: SettledFit | None = None,
) -> SettledFit | None:
    """The best fit of friction, rigidity and the named effects, from `starts` or from a grid.

    `within` is the fit of the model that the last of the effects is added to. None when nothing can be
    solved, or when that effect changes none of the values. Raises BadInput for a sequence that cannot be run.
    """
    residuals = _Residuals(problem, names)
    if starts is None:
        starts = _starts(residuals, within)
    best = None
    for start in starts:
        found = least_squares(
            residuals,
            np.clip(start, residuals.low + 1e-9, residuals.high - 1e-9),
            residuals.jacobian,
            (residuals.low, residuals.high),
            max_nfev=MOST_EVALUATIONS,
            xtol=1e-6,
            ftol=1e-6,
        )
        if best is None or found.cost < best.cost:
            best = found
    if best is None or not np.all(np.isfinite(residuals.predicted(best.x))):
        return None
    n = len(problem.values)
    jacobian = residuals.jacobian(best.x)
    covariance: Array = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True).astype(np.float64)
    data = jacobian[:n]
    used = float(np.trace(data @ covariance @ data.T))
    return SettledFit(
        tuple(names),
        residuals.parameters,
        best.x,
        residuals.predicted(best.x),
        float(best.fun[:n] @ best.fun[:n]),
        float(best.fun @ best.fun),
        covariance,
        n - used,
        np.asarray(best.fun[n + 1 :]),
    )


def held_out_error(problem: SettledProblem, found: SettledFit) -> float:
    """Cross-validation: root mean square error, in standard errors, of motions left out of the fit in
    turn."""
    motions = [(v.of.sequence, v.of.motion) for v in problem.values]
    squares = []
    for motion in dict.fromkeys(motions):
        out = np.array([m == motion for m in motions])
        kept = tuple(v for v, left in zip(problem.values, out, strict=True) if not left)
        again = (
            fit_settled(dataclasses.replace(problem, values=kept), found.effects, [found.x]) if kept else None
        )
        if again is None:
            return float("nan")
        predicted = problem.predict(problem.model(again.parameters, again.x))
        squares += list(((predicted - problem.measured) / problem.errors)[out] ** 2)
    return float(np.sqrt(np.mean(squares)))


def separation(problem: SettledProblem, truth: SettledFit, rival: SettledFit) -> float:
    """Separation in σ: how much worse the rival fits the prediction of `truth` than `truth` itself, with
    priors."""
    values = tuple(
        dataclasses.replace(v, value=float(p)) for v, p in zip(problem.values, truth.predicted, strict=True)
    )
    predicted = dataclasses.replace(problem, values=values)
    best = fit_settled(predicted, truth.effects, [truth.x])
    other = fit_settled(predicted, rival.effects, [rival.x])
    if best is None or other is None:
        return float("inf")
    return float(np.sqrt(max(other.objective - best.objective, 0.0)))


def _starts(residuals: _Residuals, within: SettledFit | None) -> list[Array]:
    """The best starts (p,) of a grid of frictions and strengths; none when strength changes no value."""
    old = within.x[2:] if within is not None else np.zeros(0)
    new = residuals.parameters[old.size :]
    strengths = STRENGTHS if new else (0.0,)
    rated, moved = [], not new
    for friction in (*FRICTIONS_N, *([math.exp(within.x[0])] if within is not None else [])):
        off = np.r_[math.log(friction), 0.0, old, np.zeros(len(new))]
        for strength in strengths:
            x = np.r_[off[: 2 + old.size], [0.0 if a.info.shapes else strength for a in new]]
            x = np.clip(x, residuals.low + 1e-9, residuals.high - 1e-9)
            row = residuals(x)
            change = np.abs(residuals.predicted(x) - residuals.predicted(off)) / residuals.problem.errors
            moved |= bool(np.any(change > STEP))
            rated.append((float(row @ row), tuple(x)))
    rated.sort()
    return [np.array(x) for _, x in rated[:FURTHER]] if moved else []
