"""What the gain of one more effect is worth: significance, discretisation error, cross-validation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc, chdtri, fdtrc

from needle_rig.numerics import Array
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.estimation.parameters import FreeParameter
from needle_rig.workbench.estimation.posterior import STEP
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.policy import POLICY

TINY = 1e-12
"""Sum of squares of logarithms of friction that is none."""


def gain_of(parent: Fit, child: Fit) -> float:
    """Fall of −2 log posterior from a parent to its child, as χ² of the directions gained.

    The part that a smaller scatter of the random effects brings counts as in an F test on the trials alone:
    over a few chance makes a trend, and how much friction scatters is not known before. So the prior scatter,
    which is worth some trials, is in neither of the two sums of squares.
    """
    gain = max(parent.objective - child.objective, 0.0)
    freedom = _freedom(parent, child)
    steadier = 2.0 * parent.scatter_dof * float(np.log(parent.scatter / child.scatter))
    if steadier > 0.0:
        left = parent.scatter_dof - POLICY.noise.scatter_dof - 1.0 - freedom
        before, after = (float((f.vector.trial_friction**2).sum()) for f in (parent, child))
        ratio = max(before - after, 0.0) / max(after, TINY) * left / freedom
        worth = float(chdtri(freedom, max(float(fdtrc(freedom, left, ratio)), 1e-300))) if left > 0 else 0.0
        gain = max(gain - steadier + min(worth, steadier), 0.0)
    return gain


def _freedom(parent: Fit, child: Fit) -> int:
    """Directions that a child has over its parent."""
    return max(1, child.rank - parent.rank)


def adjusted_p(parent: Fit, child: Fit, library: int) -> float:
    """Šidák-adjusted p value of the likelihood-ratio test of a child against its parent.

    Strengths at the boundary of their range halve p (Chernoff 1954). The best of m places has m chances.
    """
    added = [a for a in child.parameters if a.effect not in parent.effects]
    p = float(chdtrc(_freedom(parent, child), gain_of(parent, child)))
    if all(a.one_sided for a in added if not a.info.shapes):
        p *= 0.5
    chances = library * math.exp(log_places(added))
    return float(-np.expm1(chances * np.log1p(-min(p, 1 - 1e-16))))


def log_places(parameters: Sequence[FreeParameter]) -> float:
    """Logarithm of the number of combinations of places that were looked through."""
    return float(sum(math.log(a.chances) for a in parameters))


def within_discretisation_error(problem: Problem, parent: Fit, child: Fit) -> bool:
    """Whether the child's change of the residuals is less than three times the discretisation error along it.

    |Δr|² + Δ(pull of rigidity)² + |Δu|²/s² < 3 |Δr·e|, with the random effects u of scatter s and the first
    nuisance direction e. The changes of pulls and random effects have no discretisation error.
    """
    if not problem.nuisance[0].shape[1]:
        return False
    change = np.concatenate(parent.residuals) - np.concatenate(child.residuals)
    discretisation_error = np.concatenate(
        [n[:, 0] for n in problem.nuisance]
    )  # the first direction is the discretisation error
    pull = parent.pull_rigidity - child.pull_rigidity
    trial_friction = (parent.vector.trial_friction - child.vector.trial_friction) / child.scatter
    return bool(
        change @ change + pull**2 + trial_friction @ trial_friction
        < POLICY.evidence.discretisation_margin * abs(change @ discretisation_error)
    )


def predictive_gain(parent: CrossValidation | None, child: CrossValidation | None) -> float:
    """Fall of −2 log predictive density in cross-validation; 0 where it is not known."""
    if parent is None or child is None:
        return 0.0
    gain = parent.loss - child.loss
    return 0.0 if np.isnan(gain) else gain


def improves_cross_validation(parent: CrossValidation | None, child: CrossValidation | None) -> bool:
    """Whether the child's predictive density is higher in cross-validation."""
    return predictive_gain(parent, child) > 0.0


def asked_of(tried: int) -> float:
    """The gain in score that a law must have, the best of so many: what tells two explanations apart, and the
    price of having looked in so many places."""
    return POLICY.ties.close + 2.0 * math.log(max(tried, 1))


def predicts(values: int, parent: CrossValidation, child: CrossValidation) -> bool:
    """Whether χ² of so many values, predicted from the other commands, falls by what tells laws apart.

    What one command alone shows does not: there the predictive density rises by no more than a law's own
    uncertainty, which covers whatever that command has.
    """
    return bool(values * (parent.error**2 - child.error**2) > POLICY.ties.close)


def matters(problem: Problem, parent: Fit, child: Fit) -> bool:
    """Whether some reading changes by as much as counts, at once or as a root mean square over a trial."""
    before, after = (problem.predict(found.parameters, found.vector) for found in (parent, child))
    changes = [a - b for a, b in zip(after, before, strict=True)]
    return changes_matter(changes, problem.base.torque_scale)


def changes_matter(changes: Sequence[Array], torque_scale: float) -> bool:
    """Whether changes (readings, n) a trial, of the torque in N·m and angles in rad, count."""
    largest = np.max([np.nan_to_num(np.abs(change)).max(axis=1) for change in changes], axis=0)
    squares = [
        np.nansum(change**2, axis=1) / np.maximum(1, np.isfinite(change).sum(axis=1)) for change in changes
    ]
    rms = np.sqrt(np.max(squares, axis=0))
    size = POLICY.size
    return bool(
        nmm(float(largest[0])) > torque_scale * size.largest_nmm
        or deg(float(largest[1:].max())) > size.largest_deg
        or not size.small(nmm(float(rms[0])), "N·mm", torque_scale)
        or not size.small(deg(float(rms[1:].max())), "°")
    )


def is_negligible(found: Fit, effect: str) -> bool:
    """Whether an effect's fitted size is below the smallest that matters."""
    return size_of(found, effect) < 1.0


def has_size(found: Fit, effect: str) -> bool:
    """Whether an effect is further from nothing than the step of a derivative."""
    own = [a.effect == effect and not a.info.shapes for a in found.parameters]
    return bool(np.any(np.abs(found.vector.scaled_values[own]) > STEP))


def size_of(found: Fit, effect: str) -> float:
    """Largest fitted size of an effect, in units of the smallest that matters."""
    is_its = [a.effect == effect and not a.info.shapes for a in found.parameters]
    every = zip(found.parameters, found.vector.scaled_values, is_its, strict=True)
    return max((abs(float(x)) / max(a.smallest, 1e-12) for a, x, its in every if its), default=0.0)
