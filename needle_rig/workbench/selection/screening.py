"""What each effect would buy, from a few simulations at finite strength: where to start a fit of it.

Signatures are taken at 0.1, 0.5 and 1.5 of the typical size, because derivatives at zero strength miss most
of what dry friction does; all parameters of the present fit are projected out.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.parameters import Coordinate, against_mean
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Point, Problem
from needle_rig.workbench.policy import POLICY


@dataclass(frozen=True)
class Start:
    """Where to start a fit, and the fall of the objective that the preview expects there."""

    positions: Array
    gain: float


@dataclass(frozen=True)
class Preview:
    """What one effect would buy on top of a fit."""

    effect: str
    gain: float
    starts: tuple[Start, ...]
    """Best first."""
    error: float
    """Standard deviation of the strength (on its axis), from the smallest strength's signature."""
    estimate: float
    whole: bool = True
    """Whether every form was tried."""

    def may_reach(self, worth: float) -> bool:
        """Whether this gain, or that of a form not tried yet, may be as much as `worth`."""
        return self.gain >= worth or not self.whole


def forms(axes: Sequence[Coordinate]) -> list[Array]:
    """Positions of the form parameters to try, typical first; entries of strengths are 0."""
    choices = []
    for axis in axes:
        if not axis.info.shapes:
            choices.append([0.0])
            continue
        low, high = axis.bounds
        if axis.info.scale == "log":
            options = [0.0, -0.6, 0.6]
        else:
            options = [0.0, *[low + (high - low) * f for f in (0.125, 0.375, 0.625, 0.875)]]
        choices.append([o for o in options if low <= o <= high])
    every = [np.array(c) for c in itertools.islice(itertools.product(*choices), 200)]
    every.sort(key=lambda c: float(np.abs(c).sum()))
    if len(every) <= POLICY.screening.forms:
        return every
    return [
        every[round(i * (len(every) - 1) / (POLICY.screening.forms - 1))]
        for i in range(POLICY.screening.forms)
    ]


def out_of_reach(gain: float, asked: float) -> bool:
    """Whether the typical form's gain rules out that another form reaches what is asked."""
    policy = POLICY.screening
    return asked > policy.in_full_up_to and gain < policy.form_share * asked


def _patterns(axes: Sequence[Coordinate]) -> list[list[int]]:
    """Groups of coordinates that are tried together: items of a field one by one, single fields at once."""
    single = [i for i, a in enumerate(axes) if not a.info.shapes and a.item is None]
    each = [[i] for i, a in enumerate(axes) if not a.info.shapes and a.item is not None]
    return ([single] if single else []) + each


def preview(problem: Problem, parent: Fit, effect: str, worth: float = -1.0) -> Preview:
    """What `effect` would buy on top of `parent`. An effect that cannot be solved buys nothing.

    Every form is tried at the middle strength, the best two and the typical one at all; forms other than
    the typical one are left out where that one stays far below `worth` and below what is to be explained.
    """
    project = LinearisedFit.of(problem, parent).projection
    own = problem.axes([effect])
    axes = (*parent.axes, *own)
    residual = project.missed
    patterns = _patterns(own)
    asked = max(worth, excess(problem, parent.objective))
    starts: list[Start] = []
    error, estimate = float("inf"), 0.0

    def tried(form: Array, strengths: Sequence[float]) -> list[tuple[Array, Array]]:
        nonlocal error, estimate
        signatures: list[tuple[Array, Array]] = []
        for pattern, strength in itertools.product(patterns, strengths):
            for sign in (1.0, -1.0) if not all(own[i].one_sided for i in pattern) else (1.0,):
                positions = form.copy()
                for i in pattern:
                    low, high = own[i].bounds
                    direction = 1.0 if own[i].one_sided and high > 0 else (-1.0 if own[i].one_sided else sign)
                    positions[i] = np.clip(direction * strength, low, high)
                if not np.any([positions[i] != 0 for i in pattern]):
                    continue
                change = signature(problem, parent, axes, positions)
                if change is None:
                    continue
                projected = project(*change)
                signatures.append((positions, projected))
                size = float(projected @ projected)
                along = float(residual @ projected)
                starts.append(Start(positions, 2 * along - size))
                scale = float(np.clip(along / size, -4.0, 4.0)) if size > 0 else 0.0
                scaled = positions.copy()
                for i in pattern:
                    low, high = own[i].bounds
                    scaled[i] = np.clip(scale * positions[i], low, high)
                if abs(scale) > 0.02 and (scale > 0 or not all(own[i].one_sided for i in pattern)):
                    starts.append(Start(scaled, 0.9 * along**2 / size if size > 0 else 0.0))
                if strength == POLICY.screening.strengths[0] and size > 0:
                    here = POLICY.screening.strengths[0] / np.sqrt(size)
                    if here < error:
                        error = here
                        estimate = (
                            abs(float(along / size * strength)) if along > 0 or len(patterns) > 1 else 0.0
                        )
        return signatures

    seen: list[tuple[float, int, Array, list[tuple[Array, Array]]]] = []
    for place, form in enumerate(forms(own)):
        begun = len(starts)
        signatures = tried(
            form, POLICY.screening.strengths if place == 0 else POLICY.screening.strengths[1:2]
        )
        seen.append((max((s.gain for s in starts[begun:]), default=0.0), place, form, signatures))
        if out_of_reach(seen[0][0], asked):
            break
    seen.sort(key=lambda s: (-s[0], s[1]))
    for rank, (_, place, form, signatures) in enumerate(seen):
        if rank < POLICY.screening.forms_in_full and place > 0:
            signatures += tried(form, (POLICY.screening.strengths[0], *POLICY.screening.strengths[2:]))
        if len(patterns) > 1 and signatures:
            starts += _joint(own, patterns, signatures, residual, form)
    starts.sort(key=lambda s: -s.gain)
    kept: list[Start] = []
    for start in starts:
        if all(_apart(start.positions, k.positions) for k in kept):
            kept.append(start)
        if len(kept) == 4:
            break
    gain = max(0.0, kept[0].gain) if kept else 0.0
    return Preview(effect, gain, tuple(kept), error, estimate, len(seen) == len(forms(own)))


def _joint(
    own: Sequence[Coordinate],
    patterns: list[list[int]],
    signatures: list[tuple[Array, Array]],
    residual: Array,
    form: Array,
) -> list[Start]:
    """Starts with all items at once: their signatures fitted together, at each strength."""
    found = []
    for strength in POLICY.screening.strengths[:2]:
        columns, places = [], []
        for pattern in patterns:
            near = [
                (abs(abs(pos[pattern[0]]) - strength), -float(residual @ s), pos, s)
                for pos, s in signatures
                if pos[pattern[0]] != 0
            ]
            if near:
                _, _, pos, s = min(near, key=lambda n: (n[0], n[1]))
                columns.append(s / pos[pattern[0]])
                places.append(pattern)
        if not columns:
            continue
        matrix = np.column_stack(columns)
        square = matrix.T @ matrix + np.eye(len(columns)) * 0.01
        best = np.linalg.solve(square, matrix.T @ residual)
        positions = form.copy()
        for amount, pattern in zip(best, places, strict=True):
            for i in pattern:
                positions[i] = np.clip(amount, *own[i].bounds)
        found.append(Start(positions, 0.8 * float(best @ (matrix.T @ residual))))
    return found


def _apart(a: Array, b: Array) -> bool:
    gap = [abs(x - y) / max(0.3, 0.5 * abs(x), 0.5 * abs(y)) for x, y in zip(a, b, strict=True)]
    return max(gap, default=0.0) > 1.0


def beside(problem: Problem, parent: Fit, axes: Sequence[Coordinate], positions: Array) -> Point:
    """The parent's optimum with an effect at `positions`, each trial's slip limits as large as they were.

    Otherwise what the parent took for the trials' own friction would be there twice.
    """
    every = against_mean(axes, np.r_[parent.point.positions, positions])
    point = dataclasses.replace(parent.point, positions=every)
    try:
        before, after = _slip_limits(problem, parent.axes, parent.point), _slip_limits(problem, axes, point)
    except BadInput:
        return point
    scale = np.log(np.where((before > 0) & (after > 0), before / np.maximum(after, 1e-300), 1.0))
    return dataclasses.replace(point, trial_friction=point.trial_friction + scale)


def _slip_limits(problem: Problem, axes: Sequence[Coordinate], point: Point) -> Array:
    """Sum of both slip limits of all nodes in each trial (T,), N·m."""
    trials = enumerate(problem.trials)
    rods = [problem.model(axes, point, t).rod(binned.trial) for t, binned in trials]
    return np.array([float(rod.slip_plus_nm.sum() + rod.slip_minus_nm.sum()) for rod in rods])


def signature(
    problem: Problem, parent: Fit, axes: Sequence[Coordinate], positions: Array
) -> tuple[Array, Array] | None:
    """Whitened change of the model (n,) over all trials when the effect is put at `positions`, and what it
    moves in the trials' own friction (T,)."""
    point = beside(problem, parent, axes, positions)
    trials = range(len(problem.trials))
    try:
        readings = problem.predict(axes, point)
    except (SolverError, BadInput):
        return None
    after = problem.residuals(readings, trials)
    change = []
    for t in trials:
        change.append(parent.residuals[t] + problem.nuisance[t] @ parent.nuisance - after[t])
    found, moved = np.concatenate(change), point.trial_friction - parent.point.trial_friction
    return (found, moved - moved.mean()) if np.all(np.isfinite(found)) else None
