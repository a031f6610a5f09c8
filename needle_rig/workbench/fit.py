"""Fits of all parameters at once, in whitened units, for an objective that dry friction makes jagged.

Minimised is −2 log of the posterior, up to a constant: whitened residuals, priors as rows, and each
trial's own friction as a random effect whose scatter is integrated out (Student-t logarithms: a large
scatter is paid for once, not for every trial). Derivatives are finite differences of 0.3 % of a typical size,
taken about each trial's own friction; steps are damped and never accepted when they make the fit worse.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from needle_rig.errors import BadInput, SolverError
from needle_rig.workbench.coordinates import Coordinate, held_means
from needle_rig.workbench.problem import Point, Problem

Array = npt.NDArray[np.float64]

STEP = 0.003
ENOUGH = 0.05
"""A fit ends when the next step would lower the objective by less than this,"""
LOOSE = 2e-3
"""or by less than this share of what it is above the noise: a fit that misses by far need not be exact."""
MOST_SOLVES = 150.0
"""Solves a sample beyond which a fit does not go: a needle that snaps from balance to balance, whose instants
no derivative follows. Ageing friction takes about ten, most effects one or two."""
MOST_WALKS = 4
"""How often a fit goes on from a lower place along its least certain direction."""
SHAPE_STEPS = (0.3, -0.3)
"""How far from a fit's own shape others are tried, in positions: a factor of two on a decade's axis;"""
FINE_SHAPE_STEPS = (0.1, -0.1)
"""nearer ones that are tried, too, where minima lie close together."""
LEVEL = 1e6
"""Weight that holds the mean of the trials' own friction at 0: the friction of all is their common level; and
that of items which count against their mean. Without it the two trade places along a direction that the data
do not see, damped steps creep, and the derivatives' errors pass for knowledge."""


@dataclass(frozen=True)
class Fit:
    """A minimum. T trials, p global parameters (friction, rigidity, then k positions), q nuisances."""

    effects: tuple[str, ...]
    axes: tuple[Coordinate, ...]
    point: Point
    nuisance: Array
    objective: float
    """−2 log posterior with its log-determinants, up to a constant shared by all fits of a problem."""
    chi2: float
    """Sum of squared whitened residuals."""
    trial_loss: Array
    """Share of each trial in the objective (T,)."""
    pull_rigidity: float
    """Rigidity's distance from its stated value in prior standard deviations."""
    scatter: float
    """Relative scatter of friction from trial to trial that this fit sees,"""
    scatter_dof: float
    """and its degrees of freedom, those of its prior included."""
    covariance: Array
    """Of the global parameters (p, p), all others marginalised."""
    residuals: tuple[Array, ...]
    jacobians: tuple[Array, ...]
    """Derivatives of the whitened model (n, p + 1) a trial; the last column is the trial's own friction."""
    rank: int
    """How many directions the effects' positions span that the other parameters do not."""
    converged: bool

    @property
    def position_error(self) -> Array:
        """Standard deviation of each position (k,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance)[2:], 0.0))


def start_point(problem: Problem, log_friction: float, axes: Sequence[Coordinate] = ()) -> Point:
    """Everything at its stated value or off."""
    return Point(
        log_friction=log_friction,
        log_rigidity=float(np.log(problem.base.torsional_rigidity_nm2)),
        positions=np.zeros(len(axes)),
        trial_friction=np.zeros(len(problem.trials)),
    )


class _State:
    """Objective, rows and derivatives at one vector of parameters."""

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
        return Point(float(x[0]), float(x[1]), x[2 : self.p], x[self.p : self.p + self.trials])

    def vector(self, point: Point, nuisance: Array) -> Array:
        own = point.trial_friction
        common = point.log_friction + own.mean()
        x = np.r_[common, point.log_rigidity, point.positions, own - own.mean(), nuisance]
        for places in self.means:
            x[places] -= x[places].mean()
        return np.asarray(np.clip(x, self.low, self.high), dtype=np.float64)

    def rows(self, x: Array) -> list[Array] | None:
        point = self.point(x)
        every = range(self.trials)
        try:
            models = [self.problem.model(self.axes, point, t) for t in every]
            readings = self.problem.readings(models, list(every), MOST_SOLVES)
        except (SolverError, BadInput):
            return None
        rows = self.problem.residuals(readings, list(every))
        found = [r - n @ x[self.p + self.trials :] for r, n in zip(rows, self.problem.nuisance, strict=True)]
        return found if all(np.all(np.isfinite(r)) for r in found) else None

    def prior(self, x: Array) -> float:
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

    def level(self) -> Array:
        """Curvature (over all parameters) that holds the means."""
        curvature = np.zeros((self.low.size, self.low.size))
        for places in (np.arange(self.p, self.p + self.trials), *self.means):
            curvature[places[:, None], places] += LEVEL / places.size**2
        return curvature

    def weights(self, x: Array) -> Array:
        """Diagonal of the prior's curvature; for the trials' friction that of a bound from above."""
        noise = self.problem.noise
        own = x[self.p : self.p + self.trials]
        tight = (noise.scatter_dof + self.trials) / (noise.scatter_dof * noise.scatter**2 + (own**2).sum())
        parts = np.r_[
            0.0, self.problem.rigidity_prior**-2, self.width**-2, np.full(self.trials, tight), np.ones(self.q)
        ]
        return np.asarray(parts, dtype=np.float64)

    def pulls(self, x: Array) -> Array:
        """Distances from the prior's centre."""
        centre = np.zeros_like(x)
        centre[1] = self.stated
        centre[0] = x[0]
        return x - centre

    def derivatives(
        self, x: Array, rows: list[Array], changed: Sequence[int] | None = None
    ) -> list[Array] | None:
        """Whitened model derivatives (n, p or p + 1) a trial, one-sided, away from the nearest bound.

        Friction goes up and rigidity down: the angles, which depend on their ratio, then change alike to the
        last bit, and what only the needle's stated constants tell is not told by the steps' own error.
        """
        columns = []
        for j in range(max(self.p, self.own + 1)):
            which = slice(j, j + 1) if j < self.p else slice(self.p, self.p + self.trials)
            step = STEP * max(1.0, abs(x[j])) if 2 <= j < self.p else -STEP if j == 1 else STEP
            if np.any(x[which] + step > self.high[which]) or np.any(x[which] + step < self.low[which]):
                step = -step
            moved = x.copy()
            moved[which] += step
            after = self.rows(moved)
            if after is None:
                moved[which] -= 2 * step
                step = -step
                after = self.rows(moved)
                if after is None:
                    return None
            columns.append([(a - b) / -step for a, b in zip(after, rows, strict=True)])
        return [np.column_stack([c[t] for c in columns]) for t in range(self.trials)]


def _normal(state: _State, jacobians: list[Array], rows: list[Array]) -> tuple[Array, Array]:
    """(curvature, gradient) of the data part over all parameters."""
    p, trials, q = state.p, state.trials, state.q
    size = p + trials + q
    curvature, gradient = np.zeros((size, size)), np.zeros(size)
    for t in range(trials):
        shared, own = jacobians[t][:, :p], jacobians[t][:, state.own]
        full = np.column_stack([shared, own, state.problem.nuisance[t]])
        index = np.r_[np.arange(p), p + t, p + trials + np.arange(q)]
        curvature[np.ix_(index, index)] += full.T @ full
        gradient[index] += full.T @ rows[t]
    return curvature, gradient


def fit(
    problem: Problem,
    effects: Sequence[str],
    start: Point,
    *,
    nuisance: Array | None = None,
    iterations: int = 25,
    enough: float = ENOUGH,
) -> Fit | None:
    """The nearest minimum from `start`, or None where the model cannot be solved at `start`."""
    axes = problem.axes(effects)
    state = _State(problem, axes)
    x = state.vector(
        start, nuisance if nuisance is not None and nuisance.size == state.q else np.zeros(state.q)
    )
    rows = state.rows(x)
    if rows is None:
        return None
    value = _sum(rows) + state.prior(x)
    level = state.level()
    damping, jacobians, converged, fresh = 1e-3, None, False, False
    for _ in range(iterations):
        if jacobians is None:
            jacobians = state.derivatives(x, rows)
            fresh = True
            if jacobians is None:
                return None
        curvature, gradient = _normal(state, jacobians, rows)
        prior = state.weights(x)
        curvature[np.diag_indices_from(curvature)] += prior
        curvature += level
        gradient -= prior * state.pulls(x) + level @ x
        improved = False
        for _ in range(7):
            step = _bounded_step(state, x, curvature, gradient, damping)
            expected = float(2 * gradient @ step - step @ curvature @ step)
            if expected < enough + LOOSE * excess(problem, value):
                converged = True
                break
            after = np.clip(x + step, state.low, state.high)
            after_rows = state.rows(after)
            after_value = np.inf if after_rows is None else _sum(after_rows) + state.prior(after)
            if after_rows is not None and after_value < value:
                gained = value - after_value
                jacobians = (
                    _updated(state, jacobians, x, after, rows, after_rows)
                    if gained > 0.7 * expected
                    else None
                )
                damping = max(damping * 0.2, 1e-6) if gained > 0.5 * expected else damping
                x, rows, value = after, after_rows, after_value
                improved, fresh = True, False
                break
            damping = max(damping * 8, 1e-3)
        if converged and not fresh:
            converged, jacobians = False, None
            continue
        if converged:
            break
        if not improved:
            if fresh:
                break
            jacobians = None
    if jacobians is None or not fresh:
        jacobians = state.derivatives(x, rows)
        if jacobians is None:
            return None
    return _finish(state, tuple(effects), x, rows, value, jacobians, converged)


def through_valleys(problem: Problem, found: Fit) -> Fit:
    """A fit, or the one that goes on from lower places along the direction that the data hardly see.

    There the objective falls by less than its derivatives err, and a fit stops far from its minimum with a
    spread that knows nothing of it. A valley that bends, as one of shapes does, is left by straight walks:
    what is still above the noise is fitted again from other shapes.
    """
    for _ in range(MOST_WALKS):
        lower = _along_valley(problem, found)
        if lower is None:
            break
        again = fit(problem, found.effects, lower[0], nuisance=lower[1])
        if again is None or again.objective >= found.objective - ENOUGH:
            break
        found = again
    return over_shapes(problem, found) if excess(problem, found.objective) > 0.0 else found


def over_shapes(problem: Problem, found: Fit, steps: Sequence[float] = SHAPE_STEPS) -> Fit:
    """A fit, or a lower one from other shapes of its last effect, as long as that helps.

    Its covariance is that over all the minima met, each as likely as its objective says.
    """
    met = [found]
    for _ in range(MOST_WALKS):
        further = _from_other_shapes(problem, found, steps)
        met += further
        again = min(further, key=lambda f: f.objective, default=found)
        if again.objective > found.objective - 1.0:
            break
        found = again
    found = min(met, key=lambda f: f.objective)
    return dataclasses.replace(found, covariance=_over_minima(found, met))


def _over_minima(lowest: Fit, met: Sequence[Fit]) -> Array:
    """Covariance (p, p) about the lowest of several minima; one met twice counts once."""
    at = [np.r_[f.point.log_friction, f.point.log_rigidity, f.point.positions] for f in met]
    centre = np.r_[lowest.point.log_friction, lowest.point.log_rigidity, lowest.point.positions]
    near = np.sqrt(np.maximum(np.diag(lowest.covariance), 1e-18))
    kept: list[int] = []
    for i in sorted(range(len(met)), key=lambda i: met[i].objective):
        if all(np.any(np.abs(at[i] - at[k]) > near) for k in kept):
            kept.append(i)
    weights = np.exp([0.5 * (lowest.objective - met[i].objective) for i in kept])
    parts = [
        w * (met[i].covariance + np.outer(at[i] - centre, at[i] - centre))
        for w, i in zip(weights, kept, strict=True)
    ]
    return np.asarray(sum(parts) / weights.sum(), dtype=np.float64)


def _from_other_shapes(problem: Problem, found: Fit, steps: Sequence[float]) -> list[Fit]:
    fits = []
    for i, axis in enumerate(found.axes):
        if axis.info.shapes and axis.effect == found.effects[-1]:
            for step in steps:
                positions = found.point.positions.copy()
                positions[i] += step
                start = dataclasses.replace(found.point, positions=positions)
                fits.append(fit(problem, found.effects, start, nuisance=found.nuisance))
    return [f for f in fits if f is not None]


def _along_valley(problem: Problem, found: Fit) -> tuple[Point, Array] | None:
    """The lowest place on the least certain direction of a fit if it is lower than the fit, else None.

    All other parameters follow as the fit's derivatives say: the trials' own friction, too.
    """
    state = _State(problem, found.axes)
    at = state.vector(found.point, found.nuisance)
    curvature, _ = _normal(state, list(found.jacobians), list(found.residuals))
    curvature[np.diag_indices_from(curvature)] += state.weights(at)
    inverse = np.linalg.pinv(curvature + state.level(), hermitian=True)
    places = np.arange(2, state.p)
    own = inverse[np.ix_(places, places)]
    size = np.sqrt(np.diag(own))
    if not np.all(size > 0.0):
        return None
    spread, directions = np.linalg.eigh(own / np.outer(size, size))
    lowest, lower = found.chi2 + state.prior(at) - ENOUGH, None
    along = np.sqrt(max(spread[-1], 0.0)) * size * directions[:, -1]
    move = inverse[:, places] @ np.linalg.lstsq(own, along, rcond=1e-12)[0]
    for sigmas in (3.0, -3.0, 10.0, -10.0, 30.0, -30.0, 100.0, -100.0):
        moved = np.clip(at + sigmas * move, state.low, state.high)
        rows = state.rows(moved)
        value = np.inf if rows is None else _sum(rows) + state.prior(moved)
        if value < lowest:
            lowest, lower = value, moved
    return None if lower is None else (state.point(lower), lower[state.p + state.trials :])


def excess(problem: Problem, value: float) -> float:
    """How far an objective lies above what noise alone explains."""
    size = problem.size
    return max(0.0, value - size - 5.0 * float(np.sqrt(2.0 * size)))


def fit_without_derivatives(
    problem: Problem, effects: Sequence[str], start: Point, evaluations: int = 200
) -> Fit | None:
    """A simplex search over friction, rigidity and positions, then the usual fit from where it ended."""
    axes = problem.axes(effects)
    state = _State(problem, axes)
    x = state.vector(start, np.zeros(state.q))
    scale = np.r_[0.1, 0.02, np.full(state.k, 0.3)]

    def objective(moved: Array) -> float:
        full = x.copy()
        full[: state.p] = np.clip(x[: state.p] + scale * moved, state.low[: state.p], state.high[: state.p])
        rows = state.rows(full)
        return 1e12 if rows is None else _sum(rows) + state.prior(full)

    search: Any = minimize
    found = search(
        objective,
        np.zeros(state.p),
        method="Nelder-Mead",
        options={"maxfev": evaluations},
    )
    full = x.copy()
    full[: state.p] = np.clip(x[: state.p] + scale * found.x, state.low[: state.p], state.high[: state.p])
    return fit(problem, effects, state.point(full))


def _sum(rows: Sequence[Array]) -> float:
    return float(sum(r @ r for r in rows))


def _bounded_step(state: _State, x: Array, curvature: Array, gradient: Array, damping: float) -> Array:
    """Damped step that stays within bounds: parameters that run into one are held there."""
    free = np.ones(x.size, bool)
    step = np.zeros(x.size)
    for _ in range(4):
        damped = curvature + damping * np.diag(np.diag(curvature) + 1e-9)
        step[:] = np.where(free, 0.0, step)
        held = ~free
        right = gradient[free] - curvature[np.ix_(free, held)] @ step[held]
        step[free] = np.linalg.solve(damped[np.ix_(free, free)], right)
        out = free & ((x + step > state.high) | (x + step < state.low))
        if not out.any():
            break
        step[out] = np.clip(x[out] + step[out], state.low[out], state.high[out]) - x[out]
        free &= ~out
    return np.asarray(np.clip(x + step, state.low, state.high) - x)


def _updated(
    state: _State, jacobians: list[Array], x: Array, after: Array, rows: list[Array], after_rows: list[Array]
) -> list[Array]:
    """Broyden's update of each trial's derivatives from a step that was taken anyway."""
    move = (after - x)[: state.p]
    updated = []
    for t, jacobian in enumerate(jacobians):
        own = np.zeros(jacobian.shape[1])
        own[: state.p] = move
        own[state.own] += after[state.p + t] - x[state.p + t]
        size = own @ own
        change = rows[t] - after_rows[t] - state.problem.nuisance[t] @ (after - x)[state.p + state.trials :]
        updated.append(jacobian + np.outer(change - jacobian @ own, own) / size if size > 1e-16 else jacobian)
    return updated


def _finish(
    state: _State,
    effects: tuple[str, ...],
    x: Array,
    rows: list[Array],
    value: float,
    jacobians: list[Array],
    converged: bool,
) -> Fit:
    problem, p, trials = state.problem, state.p, state.trials
    noise = problem.noise
    curvature, _ = _normal(state, jacobians, rows)
    weights = state.weights(x)
    curvature[np.diag_indices_from(curvature)] += weights
    inverse = np.linalg.pinv(curvature + state.level(), hermitian=True)
    own = x[p : p + trials]
    jacobians = [np.column_stack([j[:, :p], j[:, state.own]]) for j in jacobians]
    seen = np.array([j[:, p] @ j[:, p] for j in jacobians])
    room = noise.scatter_dof * noise.scatter**2
    log_det = np.log1p(seen * noise.scatter**2)
    share = np.log1p((own**2).sum() / room) * (noise.scatter_dof + trials)
    part = own**2 / max((own**2).sum(), 1e-30)
    loss = np.array([r @ r for r in rows]) + log_det + share * part
    fixed = np.r_[np.zeros(p), weights[p:]]
    rank = _rank(curvature, fixed, p)
    scatter = float(np.sqrt((room + (own**2).sum()) / (noise.scatter_dof + trials)))
    # the trials' mean is a draw of their scatter: how far it carries the parameters that it can stand for
    shared, common = np.vstack([j[:, :p] for j in jacobians]), np.concatenate([j[:, p] for j in jacobians])
    carried = np.linalg.lstsq(shared, common, rcond=1e-9)[0]
    covariance = inverse[:p, :p] + scatter**2 / trials * np.outer(carried, carried)
    return Fit(
        effects=effects,
        axes=state.axes,
        point=state.point(x.copy()),
        nuisance=x[p + trials :].copy(),
        objective=value + float(log_det.sum()),
        chi2=_sum(rows),
        trial_loss=loss,
        pull_rigidity=float((x[1] - state.stated) / problem.rigidity_prior),
        scatter=scatter,
        scatter_dof=noise.scatter_dof + trials,
        covariance=np.asarray(covariance, dtype=np.float64),
        residuals=tuple(rows),
        jacobians=tuple(jacobians),
        rank=rank,
        converged=converged,
    )


def _rank(curvature: Array, fixed: Array, p: int) -> int:
    """Directions among the positions that the data see, the other parameters projected out."""
    inside = np.arange(2, p)
    if not inside.size:
        return 0
    outside = np.r_[0, 1, np.arange(p, curvature.shape[0])]
    cross = curvature[np.ix_(inside, outside)]
    rest = curvature[np.ix_(outside, outside)] + 1e-9 * np.eye(outside.size)
    left = curvature[np.ix_(inside, inside)] - cross @ np.linalg.solve(rest, cross.T)
    return max(1, int((np.linalg.eigvalsh(left) > 1.0).sum()))
