"""Screening: a score test at finite strength of each effect, from a few simulations, and starts for its fit.

A signature is the whitened response of the model to an effect at 0.1, 0.5 and 1.5 of its typical size,
because derivatives at zero strength miss most of what dry friction does. All parameters of the current fit
are projected out of it.
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
from needle_rig.workbench.estimation.parameters import FreeParameter, against_mean
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import ParameterVector, Problem
from needle_rig.workbench.policy import POLICY

FORM_STEPS = (-0.6, 0.6)
"""Form parameters that are tried beside the typical one on a logarithmic scale: factors of 4."""
FORM_SHARES = (0.125, 0.375, 0.625, 0.875)
"""Form parameters that are tried on any other scale: the middles of the quarters of its range."""
MOST_FORMS = 200
"""Combinations of form parameters of which those to try are taken."""
LEAST_SCALE, MOST_SCALE = 0.02, 4.0
"""A signature is scaled to the best size within these: dry friction is far from linear."""
SCALED_SHARE = 0.9
"""Share of the gain of a scaled signature that is expected, beside that of one as simulated."""
JOINT_SHARE = 0.8
"""Share of the gain of several signatures together that is expected."""
RIDGE = 0.01
"""Ridge of the fit of several signatures together, against collinear ones."""
MOST_STARTS = 4
"""Distinct starts of an effect that are kept."""
APART, APART_SHARE = 0.3, 0.5
"""Starts are distinct when a scaled value differs by this, or by this share of itself."""


@dataclass(frozen=True)
class Start:
    """Where to start a fit: scaled values (k,) of the effect, and the expected fall of the objective."""

    scaled_values: Array
    gain: float


@dataclass(frozen=True)
class Screening:
    """Score test of one effect added to a fit."""

    effect: str
    gain: float
    """Expected fall of the objective."""
    starts: tuple[Start, ...]
    """Best first."""
    error: float
    """Standard deviation of the strength, scaled, from the signature at the smallest strength."""
    estimate: float
    """The strength itself, scaled, from the same signature."""
    whole: bool = True
    """Whether every form was tried."""
    nonlinearity: float = 0.0
    """Share of the response at the largest strength that the smallest, continued straight, does not predict;
    the largest of its items, at typical forms."""

    def may_reach(self, worth: float) -> bool:
        """Whether this gain, or that of a form not tried yet, may be as much as `worth`."""
        return self.gain >= worth or not self.whole


def forms(parameters: Sequence[FreeParameter]) -> list[Array]:
    """Scaled values of the form parameters to try, typical first; entries of strengths are 0."""
    choices = []
    for parameter in parameters:
        if not parameter.info.shapes:
            choices.append([0.0])
            continue
        low, high = parameter.bounds
        if parameter.info.scale == "log":
            options = [0.0, *FORM_STEPS]
        else:
            options = [0.0, *[low + (high - low) * f for f in FORM_SHARES]]
        choices.append([o for o in options if low <= o <= high])
    every = [np.array(c) for c in itertools.islice(itertools.product(*choices), MOST_FORMS)]
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


def _tried_together(parameters: Sequence[FreeParameter]) -> list[list[int]]:
    """Groups of parameters that are tried together: items of a field one by one, single fields at once."""
    single = [i for i, a in enumerate(parameters) if not a.info.shapes and a.item is None]
    each = [[i] for i, a in enumerate(parameters) if not a.info.shapes and a.item is not None]
    return ([single] if single else []) + each


def screen(problem: Problem, parent: Fit, effect: str, worth: float = -1.0) -> Screening:
    """Score test of `effect` added to `parent`; its gain is 0 where the model cannot be solved.

    Every form is tried at the middle strength; the best forms and the typical one at all strengths. The other
    forms are left out where the typical one gains far less than `worth` and than the excess over the noise.
    """
    project = LinearisedFit.of(problem, parent).projection
    added = problem.parameters([effect])
    parameters = (*parent.parameters, *added)
    residual = project.missed
    groups = _tried_together(added)
    asked = max(worth, excess(problem, parent.objective))
    starts: list[Start] = []
    error, estimate = float("inf"), 0.0

    def tried(form: Array, strengths: Sequence[float]) -> list[tuple[Array, Array]]:
        nonlocal error, estimate
        signatures: list[tuple[Array, Array]] = []
        for group, strength in itertools.product(groups, strengths):
            for sign in (1.0, -1.0) if not all(added[i].one_sided for i in group) else (1.0,):
                scaled_values = form.copy()
                for i in group:
                    low, high = added[i].bounds
                    direction = (
                        1.0 if added[i].one_sided and high > 0 else (-1.0 if added[i].one_sided else sign)
                    )
                    scaled_values[i] = np.clip(direction * strength, low, high)
                if not np.any([scaled_values[i] != 0 for i in group]):
                    continue
                change = signature(problem, parent, parameters, scaled_values)
                if change is None:
                    continue
                projected = project(*change)
                signatures.append((scaled_values, projected))
                size = float(projected @ projected)
                along = float(residual @ projected)
                starts.append(Start(scaled_values, 2 * along - size))
                scale = float(np.clip(along / size, -MOST_SCALE, MOST_SCALE)) if size > 0 else 0.0
                at_best = scaled_values.copy()
                for i in group:
                    low, high = added[i].bounds
                    at_best[i] = np.clip(scale * scaled_values[i], low, high)
                if abs(scale) > LEAST_SCALE and (scale > 0 or not all(added[i].one_sided for i in group)):
                    starts.append(Start(at_best, SCALED_SHARE * along**2 / size if size > 0 else 0.0))
                if strength == POLICY.screening.strengths[0] and size > 0:
                    here = POLICY.screening.strengths[0] / np.sqrt(size)
                    if here < error:
                        error = here
                        estimate = (
                            abs(float(along / size * strength)) if along > 0 or len(groups) > 1 else 0.0
                        )
        return signatures

    seen: list[tuple[float, int, Array, list[tuple[Array, Array]]]] = []
    for place, form in enumerate(forms(added)):
        begun = len(starts)
        signatures = tried(
            form, POLICY.screening.strengths if place == 0 else POLICY.screening.strengths[1:2]
        )
        seen.append((max((s.gain for s in starts[begun:]), default=0.0), place, form, signatures))
        if out_of_reach(seen[0][0], asked):
            break
    nonlinearity = _nonlinearity(groups, seen[0][3])
    seen.sort(key=lambda s: (-s[0], s[1]))
    for rank, (_, place, form, signatures) in enumerate(seen):
        if rank < POLICY.screening.forms_in_full and place > 0:
            signatures += tried(form, (POLICY.screening.strengths[0], *POLICY.screening.strengths[2:]))
        if len(groups) > 1 and signatures:
            starts += _joint(added, groups, signatures, residual, form)
    starts.sort(key=lambda s: -s.gain)
    kept: list[Start] = []
    for start in starts:
        if all(_apart(start.scaled_values, k.scaled_values) for k in kept):
            kept.append(start)
        if len(kept) == MOST_STARTS:
            break
    gain = max(0.0, kept[0].gain) if kept else 0.0
    return Screening(effect, gain, tuple(kept), error, estimate, len(seen) == len(forms(added)), nonlinearity)


def _nonlinearity(groups: list[list[int]], signatures: list[tuple[Array, Array]]) -> float:
    """`Screening.nonlinearity` of the signatures of one form."""
    missed = [0.0]
    for group in groups:
        strengths = [(values[group[0]], response) for values, response in signatures if values[group[0]] != 0]
        for sign in (1.0, -1.0):
            way = sorted(
                ((sign * at, response) for at, response in strengths if sign * at > 0), key=lambda w: w[0]
            )
            if len(way) > 1:
                (least, low), (most, high) = way[0], way[-1]
                missed.append(
                    float(np.linalg.norm(high - low * most / least) / (np.linalg.norm(high) or 1.0))
                )
    return max(missed)


def _joint(
    added: Sequence[FreeParameter],
    groups: list[list[int]],
    signatures: list[tuple[Array, Array]],
    residual: Array,
    form: Array,
) -> list[Start]:
    """Starts with all items at once: their signatures fitted together, at each strength."""
    found = []
    for strength in POLICY.screening.strengths[:2]:
        columns, places = [], []
        for group in groups:
            near = [
                (abs(abs(pos[group[0]]) - strength), -float(residual @ s), pos, s)
                for pos, s in signatures
                if pos[group[0]] != 0
            ]
            if near:
                _, _, pos, s = min(near, key=lambda n: (n[0], n[1]))
                columns.append(s / pos[group[0]])
                places.append(group)
        if not columns:
            continue
        best, gain = together(np.column_stack(columns), residual)
        scaled_values = form.copy()
        for amount, group in zip(best, places, strict=True):
            for i in group:
                scaled_values[i] = np.clip(amount, *added[i].bounds)
        found.append(Start(scaled_values, JOINT_SHARE * gain))
    return found


def together(matrix: Array, residual: Array) -> tuple[Array, float]:
    """(amounts (m,), gain) of signatures (n, m) fitted together to what is missed (n,)."""
    ridge = np.sqrt(RIDGE) * np.eye(matrix.shape[1])
    padded = np.r_[residual, np.zeros(matrix.shape[1])]
    best = np.linalg.lstsq(np.vstack([matrix, ridge]), padded, rcond=None)[0]
    return best, float(best @ (matrix.T @ residual))


def _apart(a: Array, b: Array) -> bool:
    gap = [
        abs(x - y) / max(APART, APART_SHARE * abs(x), APART_SHARE * abs(y)) for x, y in zip(a, b, strict=True)
    ]
    return max(gap, default=0.0) > 1.0


def beside(
    problem: Problem, parent: Fit, parameters: Sequence[FreeParameter], scaled_values: Array
) -> ParameterVector:
    """The parent's optimum with an effect at `scaled_values`, each trial's slip limits as large as before.

    Otherwise friction that the random effects stand for in the parent would be there twice.
    """
    every = against_mean(parameters, np.r_[parent.vector.scaled_values, scaled_values])
    vector = dataclasses.replace(parent.vector, scaled_values=every)
    added = {p.effect for p in parameters[len(parent.parameters) :]}
    if not any(problem.library[effect].has("shape") for effect in added):
        return vector
    try:
        before, after = (
            _slip_limits(problem, parent.parameters, parent.vector),
            _slip_limits(problem, parameters, vector),
        )
    except BadInput:
        return vector
    scale = np.log(np.where((before > 0) & (after > 0), before / np.maximum(after, 1e-300), 1.0))
    return dataclasses.replace(vector, trial_friction=vector.trial_friction + scale)


def _slip_limits(problem: Problem, parameters: Sequence[FreeParameter], vector: ParameterVector) -> Array:
    """Sum of both slip limits of all nodes that can slip in each trial (T,), N·m."""
    rods = problem.model(parameters, vector).rods([b.trial for b in problem.trials])
    limits_nm = [rod.slip_plus_nm + rod.slip_minus_nm for rod in rods]
    sums_nm = np.array([float(limit_nm[np.isfinite(limit_nm)].sum()) for limit_nm in limits_nm])
    return sums_nm * np.exp(vector.trial_friction)


def signature(
    problem: Problem, parent: Fit, parameters: Sequence[FreeParameter], scaled_values: Array
) -> tuple[Array, Array] | None:
    """Whitened response of the model (n,) over all trials to an effect at `scaled_values`, and the change of
    the trials' friction (T,) that goes with it. None where the model cannot be solved."""
    vector = beside(problem, parent, parameters, scaled_values)
    trials = range(len(problem.trials))
    try:
        readings = problem.predict(parameters, vector)
    except (SolverError, BadInput):
        return None
    after = problem.residuals(readings, trials)
    change = []
    for t in trials:
        change.append(parent.residuals[t] + problem.nuisance[t] @ parent.nuisance - after[t])
    found, moved = np.concatenate(change), vector.trial_friction - parent.vector.trial_friction
    return (found, moved - moved.mean()) if np.all(np.isfinite(found)) else None
