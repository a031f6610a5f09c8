"""The residual where too little was repeated, held against noise that wanders, and against hum.

Settled stretches are short: noise that is correlated over seconds, or hum, is an offset there. Replicates
tell it from what a model lacks; without them the residual, if noise may wander by as much, can be either: it
is taken for noise, so that none of it is called an effect, and that is said. Hum has one frequency, and a
phase of its own in each trial and channel: what no effect explains, and such a line takes down to the noise,
is hum.
"""

from __future__ import annotations

import math

import numpy as np

from needle_rig.workbench.estimation.baseline import Baseline, under_noise
from needle_rig.workbench.estimation.cross_validation import cross_validate
from needle_rig.workbench.estimation.discretisation_error import refitted
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.observations.hum import with_hum_left
from needle_rig.workbench.observations.noise import Noise, covariance
from needle_rig.workbench.observations.replicate_noise import replicates_favour, with_correlation_left
from needle_rig.workbench.observations.snaps import snaps
from needle_rig.workbench.policy import POLICY


def left_to_white(problem: Problem, found: Fit) -> float:
    """Root mean square of the residuals beyond the noise, in units of a sample's white noise, of the channel
    with most; infinite with replicates."""
    noise = problem.noise
    if noise.replicates:
        return math.inf
    left = problem.raw(found.residuals)
    largest = 0.0
    for c, white in enumerate(noise.white):
        square = variance = 0.0
        for trial, residuals in zip(problem.trials, left, strict=True):
            use, stated = covariance(noise, trial, c)
            square += float((residuals[c][use] ** 2).sum()) - float(np.trace(stated))
            variance += use.size * float(white) ** 2
        if variance > 0.0:  # not so of a sensor that is dead
            largest = max(largest, square / variance)
    return math.sqrt(largest)


def may_wander(share: float) -> bool:
    """Whether noise that wanders may leave this `left_to_white`."""
    return share <= POLICY.verdict.wandering


def under_hum(baseline: Baseline, problem: Problem, found: Fit) -> tuple[Baseline, str] | None:
    """The baseline under noise with the hum that all trials show beyond `found`, and a note.

    None where they show none, or it leaves more than noise of what `found` predicts.
    """
    if problem.noise.hum.any():
        return None
    noise = with_hum_left(problem.noise, problem.trials, problem.whiteners, found.residuals)
    humming = under_noise(baseline, problem, noise)
    if humming is baseline:
        return None
    validation = cross_validate(humming.problem, refitted(humming.problem, found))
    return (humming, _hum_note(noise)) if validation.error <= POLICY.verdict.reached else None


def under_wander(baseline: Baseline, problem: Problem, found: Fit) -> tuple[Baseline, str] | None:
    """The baseline under noise with the correlated part that all trials show beyond `found`, and a note.

    None where they show none or more than may wander, where replicates do not bear it out, or after a snap.
    """
    if snaps(baseline.dataset):
        return None
    known, left = problem.noise, problem.raw(found.residuals)
    noise = with_correlation_left(known, problem.trials, left)
    if not may_wander(wander(noise)):
        return None
    if known.replicates and not replicates_favour(noise, known, problem.trials, left, problem.groups):
        return None
    wandering = under_noise(baseline, problem, noise)
    return None if wandering is baseline else (wandering, _wander_note(noise))


def wander(noise: Noise) -> float:
    """Largest correlated part, in units of its channel's white one."""
    return float(np.max(noise.correlated / noise.white))


def _hum_note(noise: Noise) -> str:
    """What was taken for noise, and the experiment that would tell."""
    return (
        f"The residual oscillates at {noise.hum_hz:.2g} Hz, with a phase of its own in each trial and"
        " channel, and no effect explains it: it is taken for noise, hum as the sampling sees it, or what"
        " wanders about as slowly. Sample faster, or repeat one command three times, to be sure."
    )


def _wander_note(noise: Noise) -> str:
    """What was taken for noise, and the experiment that would tell."""
    taken = (
        f"The residual, {wander(noise):.2g} × the white noise of a sample at most, is taken for noise that"
        " wanders over seconds."
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


def note(share: float) -> str:
    """What cannot be told, and the experiment that would."""
    return (
        f"The residual beyond the noise, {share:.2g} × the white noise of a sample at most, may be noise that"
        " wanders over seconds or a missing effect as small: without a repeated command nobody can tell."
        " Repeat one command three times."
    )
