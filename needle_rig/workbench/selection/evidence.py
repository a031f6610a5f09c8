"""What the gain of one more effect is worth: against chance, our own error, and commands left out."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc, chdtri, fdtrc

from needle_rig.workbench.estimation.cross_validation import HeldOut
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.policy import POLICY


def chance(parent: Fit, child: Fit, library: int) -> float:
    """Probability, adjusted over the library, that noise makes a gain like this.

    The share of the gain that comes from trials whose own friction scatters less counts as that of an F-test:
    over a few trials chance alone makes a trend.
    """
    gain = max(parent.objective - child.objective, 0.0)
    freedom = max(1, child.rank - parent.rank)
    steadier = 2.0 * parent.scatter_dof * float(np.log(parent.scatter / child.scatter))
    if steadier > 0.0:
        left = max(1.0, parent.scatter_dof - 1.0 - freedom)
        ratio = float(np.expm1(steadier / parent.scatter_dof)) * left / freedom
        worth = float(chdtri(freedom, max(float(fdtrc(freedom, left, ratio)), 1e-300)))
        gain = max(gain - steadier + min(worth, steadier), 0.0)
    new = [a for a in child.axes if a.effect not in parent.effects and not a.info.shapes]
    p = float(chdtrc(freedom, gain))
    if all(a.one_sided for a in new):
        p *= 0.5
    return float(-np.expm1(library * np.log1p(-min(p, 1 - 1e-16))))


def may_be_ours(problem: Problem, parent: Fit, child: Fit) -> bool:
    """Whether what the child changes is under three times our solver's own error along it.

    What the needle's constants and the trials' own friction are relieved of is a part of the change that our
    error has none of.
    """
    if not problem.nuisance[0].shape[1]:
        return False
    change = np.concatenate(parent.residuals) - np.concatenate(child.residuals)
    ours = np.concatenate([n[:, 0] for n in problem.nuisance])  # the first direction is the solver's
    pull = parent.pull_rigidity - child.pull_rigidity
    own = (parent.point.trial_friction - child.point.trial_friction) / child.scatter
    return bool(
        change @ change + pull**2 + own @ own < POLICY.evidence.discretisation_margin * abs(change @ ours)
    )


def held_gain(parent: HeldOut | None, child: HeldOut | None) -> float:
    """Fall of −2 log predictive density on commands left out."""
    if parent is None or child is None:
        return 0.0
    gain = parent.loss - child.loss
    return 0.0 if np.isnan(gain) else gain


def foretells(parent: Fit, parent_held: HeldOut | None, child: Fit, child_held: HeldOut | None) -> bool:
    """Whether commands left out speak for the child, or the needle's stated constants do and these do not
    speak against it."""
    if held_gain(parent_held, child_held) > 0:
        return True
    relieved = parent.pull_rigidity**2 - child.pull_rigidity**2
    if parent_held is None or child_held is None or relieved <= POLICY.evidence.relieved_pull:
        return False
    return bool(child_held.error <= POLICY.evidence.held_out_rise * parent_held.error)


def is_negligible(found: Fit, effect: str) -> bool:
    """Whether an effect's fitted size is below the smallest that matters."""
    return size_of(found, effect) < 1.0


def size_of(found: Fit, effect: str) -> float:
    """Largest fitted size of an effect, in units of the smallest that matters."""
    own = [a.effect == effect and not a.info.shapes for a in found.axes]
    every = zip(found.axes, found.point.positions, own, strict=True)
    return max((abs(float(x)) / max(a.smallest, 1e-12) for a, x, is_own in every if is_own), default=0.0)
