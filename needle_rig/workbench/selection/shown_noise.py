"""The noise that shows beside the effects which a search has found.

Replicates tell noise from what a model lacks: their contrasts do not hold it. Settled stretches alone are
short: noise that is correlated over seconds, or interference, is an offset there. Where the residual is above
the noise and replicates do not tell, the residual may be such noise. The term under which it is likeliest is
taken, up to a bound: no more than the white noise of a sample. A larger residual is something missing.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.workbench.estimation.baseline import (
    Baseline,
    under_noise,
    with_noise_at,
    with_samples_at,
    with_starts_of,
)
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.observations.noise import Noise
from needle_rig.workbench.observations.noise_terms.interference import Interference
from needle_rig.workbench.observations.noise_terms.term import ShownTerm
from needle_rig.workbench.observations.shown_terms import with_residual_term
from needle_rig.workbench.observations.snaps import snaps
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.search import SearchTrace


def renewed(baseline: Baseline, given: Dataset, trace: SearchTrace) -> tuple[Baseline, str] | None:
    """The baseline under the noise, or driven by the path, that the best set of a search asks for.

    With what to say of it; None where both are as they were.
    """
    problem, (found, _) = trace.problem, trace.fits[trace.best]
    other = with_noise_at(baseline, problem, found)
    if other is not baseline:
        return other, "going on under the noise that shows beside what was found"
    other = with_starts_of(baseline, given, found)
    if other is not baseline:
        return other, "going on from the initial twists that what was found holds"
    alone = trace.best_alone()
    if alone is not None:
        other = with_samples_at(baseline, problem, alone, alone.objective - found.objective)
        if other is not baseline:
            return other, "going on, driven by every sample"
    if excess(problem, found.objective) <= 0.0:
        return None
    noise = left_over(baseline, problem, found)
    other = under_noise(baseline, problem, noise)
    if other is baseline:
        return None
    told = (*other.assumed_noise, _sentence(noise))
    return dataclasses.replace(other, assumed_noise=told), "going on under noise that the residual shows"


def left_over(baseline: Baseline, problem: Problem, found: Fit) -> Noise:
    """The noise with the term, within its bound, that the residuals of a fit show; itself where they show
    none."""
    known = problem.noise
    if snaps(baseline.dataset):  # a slip event comes at another instant in each replicate
        return known
    noise = with_residual_term(known, problem.trials, problem.raw(found.residuals), problem.groups)
    return (
        known if noise is known or _largest(noise, noise.shown[-1]) > POLICY.noise.residual_share else noise
    )


def _largest(noise: Noise, term: ShownTerm) -> float:
    """Largest size of a term, in units of its channel's white part."""
    return float(np.max(term.sd / noise.white))


def _sentence(noise: Noise) -> str:
    """What was taken for noise, and the experiment that would tell."""
    term = noise.shown[-1]
    if isinstance(term, Interference):
        return (
            f"The residual oscillates at {term.form[0]:.2g} Hz, with a phase of its own in each trial and"
            " channel: it is taken for interference as the sampling sees it, or for drift as slow. Sample"
            " faster, or repeat one command three times, to be sure."
        )
    taken = (
        f"The residual, {_largest(noise, term):.2g} × the white noise of a sample at most, is taken for noise"
        " drift over seconds."
    )
    if noise.replicates:
        return (
            f"{taken} The repeated commands are likelier with it than without, but too few to show it by"
            " themselves. Repeat one command more often."
        )
    return (
        f"{taken} A missing effect as small would be told from it by a repeated command alone. Repeat one"
        " command three times."
    )
