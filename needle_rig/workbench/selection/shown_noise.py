"""The noise that shows beside the effects which a search has found.

Replicates tell noise from what a model lacks: their contrasts do not hold it. Settled stretches alone are
short: noise that is correlated over seconds, or interference, is an offset there. Where the residual is above
the noise and replicates do not tell, the residual may be such noise. The term under which it is likeliest is
taken, up to a bound: no more than the white noise of a sample. A larger residual is something missing.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.baseline import Baseline, under_noise, with_noise_at, with_samples_at
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.observations.hum import with_hum_left
from needle_rig.workbench.observations.noise import Noise, covariance, whitener
from needle_rig.workbench.observations.replicate_noise import replicates_favour, with_correlation_left
from needle_rig.workbench.observations.snaps import snaps
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.search import SearchTrace
from needle_rig.workbench.selection.verdict import above_noise, may_be_noise


def renewed(baseline: Baseline, trace: SearchTrace) -> tuple[Baseline, str] | None:
    """The baseline under the noise, or driven by the path, that the best set of a search asks for.

    With what to say of it; None where both are as they were.
    """
    problem, (found, validation) = trace.problem, trace.fits[trace.best]
    other = with_noise_at(baseline, problem, found)
    if other is not baseline:
        return other, "going on under the noise that shows beside what was found"
    alone = trace.best_alone()
    if alone is not None:
        other = with_samples_at(baseline, problem, alone, alone.objective - found.objective)
        if other is not baseline:
            return other, "going on, driven by every sample"
    held_out = math.inf if validation is None else validation.error
    error = held_out if math.isfinite(held_out) else math.sqrt(found.chi2 / problem.size)
    if not above_noise(error, POLICY.verdict.reached):
        return None
    noise = left_over(baseline, problem, found)
    other = under_noise(baseline, problem, noise)
    if other is baseline:
        return None
    told = (*other.assumed_noise, _sentence(problem.noise, noise))
    return dataclasses.replace(other, assumed_noise=told), "going on under noise that the residual shows"


def left_over(baseline: Baseline, problem: Problem, found: Fit) -> Noise:
    """The noise with the term, within its bound, under which the residuals of a fit are likeliest.

    `problem.noise` itself where no term shows, or replicates do not support it.
    """
    known, raw = problem.noise, problem.raw(found.residuals)
    terms = [known]
    if not known.hum.any():
        terms.append(with_hum_left(known, problem.trials, problem.whiteners, found.residuals))
    if not snaps(baseline.dataset):  # a slip event comes at another instant in each replicate
        correlated = with_correlation_left(known, problem.trials, raw)
        if not known.replicates or replicates_favour(correlated, known, problem.trials, raw, problem.groups):
            terms.append(correlated)
    within = [noise for noise in terms if noise is known or may_be_noise(_largest(noise))]
    return min(within, key=lambda noise: _deviance(problem, noise, raw))


def _deviance(problem: Problem, noise: Noise, raw: list[Array]) -> float:
    """−2 log density of residuals in bin means (C, K), a trial each, under `noise`, up to a constant."""
    found = 0.0
    for binned, residuals in zip(problem.trials, raw, strict=True):
        whiten = whitener(noise, binned)
        white = whiten(residuals)
        found += float(white @ white) + whiten.log_det
    return found


def _largest(noise: Noise) -> float:
    """Largest correlated part or interference, in units of its channel's white one."""
    return float(np.max(np.maximum(noise.correlated, noise.hum) / noise.white))


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


def _sentence(before: Noise, noise: Noise) -> str:
    """What was taken for noise, and the experiment that would tell."""
    if not np.array_equal(before.hum, noise.hum):
        return (
            f"The residual oscillates at {noise.hum_hz:.2g} Hz, with a phase of its own in each trial and"
            " channel: it is taken for interference as the sampling sees it, or for drift as slow. Sample"
            " faster, or repeat one command three times, to be sure."
        )
    taken = (
        f"The residual, {_largest(noise):.2g} × the white noise of a sample at most, is taken for noise drift"
        " over seconds."
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
        f"The residual beyond the noise, {share:.2g} × the white noise of a sample at most, may be noise"
        " drift over seconds or a missing effect as small: without a repeated command nobody can tell."
        " Repeat one command three times."
    )
