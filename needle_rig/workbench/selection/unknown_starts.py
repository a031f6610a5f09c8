"""Shafts that were wound when the recording began: their starts, found with the effect that holds them.

Starts that are found without an effect can hide it: friction at the tip is taken for shafts that are wound
less. Starts that are found with an effect favour it. They are found with each of the effects that screening
promises most of, and where commands left out are then not predicted to within the noise, with each that can
hold a shaft, at its typical size, as it need not show in other starts; the effect with which they are
predicted best is kept. Its relatives are tried from their own starts, too: from its starts they look worse
than they are.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

from needle_rig.dataset import Dataset
from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.estimation.baseline import Baseline, fit_baseline, judged
from needle_rig.workbench.estimation.cross_validation import cross_validate
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.multistart import over_strength
from needle_rig.workbench.estimation.parameters import either_way
from needle_rig.workbench.estimation.problem import ParameterVector, Problem
from needle_rig.workbench.observations.binning import bin_trial
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.screening import beside, screen
from needle_rig.workbench.selection.search import SearchTrace, related

ROUNDS = 8
"""Most times that starts are found with the fit to those before; rigid shafts take three to six."""
MOST_PROMISING = 3
"""Effects of which screening promises most that are tried."""
SAME = 5e-4
"""Relative change of the error in a round after which starts and fit hold each other: three in −2 log
predictive density for three thousand values, below what tells two explanations apart."""
HOLDING = ("shape", "torque")
"""Hooks of an effect that can hold twist in a shaft at rest."""


Task = tuple[tuple[str, ...], ParameterVector]
"""Effects and where their fit starts."""


@dataclass(frozen=True)
class Holder:
    """An effect with the starts that it holds."""

    at: ParameterVector
    """Of the effects, with which the starts were found."""
    fit: Fit
    error: float
    """On commands left out, on those fitted where there is one alone; see `_error`."""


@dataclass(frozen=True)
class FoundStarts:
    """Starts as one more effect holds them."""

    problem: Problem
    """With the starts of the current model: errors are in its noise."""
    baseline: Baseline
    fit: Fit | None
    """Of that effect; None where no effect predicts more than the current model's own starts."""
    holders: Mapping[str, Holder]
    """Every effect that was tried, with the starts that it holds."""
    least: float
    """Error of the current model from its own starts."""

    def behind(self, effect: str) -> dict[str, float]:
        """−2 log predictive density of other effects from their own starts over that of `effect`.

        Of those that are better than the current model by as much as tells two explanations apart; of none
        unless the starts are those of `effect`.
        """
        if self.fit is None or self.fit.effects[-1] != effect:
            return {}
        best = self.holders[effect].error
        return {
            name: self._gain(holder.error, best)
            for name, holder in self.holders.items()
            if name != effect and self._gain(self.least, holder.error) > POLICY.ties.close
        }

    def simpler(self, dataset: Dataset, trace: SearchTrace) -> Holder | None:
        """The one of the effects named that predicts as well as they do together, each from its own starts.

        None where they predict more by as much as tells two explanations apart, and where it is named alone,
        from its own starts. A second effect can take up what the starts of another leave.
        """
        named = trace.named(trace.best)
        if self.fit is None or not named or named == [self.fit.effects[-1]]:
            return None
        together, shared = trace.fits[trace.best][0], (dataset, self.problem)
        alone = [self.holders[effect] for effect in named if effect in self.holders]
        for key in (trace.start | {effect} for effect in named if effect not in self.holders):
            if key in trace.fits:
                own = held(shared, trace.fits[key][0].effects, trace.fits[key][0].vector, self.least)
                alone += [] if own is None else [own]
        best = min(alone, key=lambda h: h.error, default=None)
        if best is None or len(named) == 1:
            return best
        all_held = held(shared, together.effects, together.vector, self.least)
        gain = 0.0 if all_held is None else self._gain(best.error, all_held.error)
        return best if gain < POLICY.ties.close else None

    def _gain(self, before: float, after: float) -> float:
        """Fall of −2 log predictive density from one error to another."""
        return 2.0 * self.problem.size * math.log(before / after)


def from_found_starts(
    dataset: Dataset,
    model: NeedleModel | None,
    library: Mapping[str, type[Effect]],
    baseline: Baseline,
    work: Work,
    quick: bool = False,
) -> FoundStarts:
    """The baseline with starts as one more effect holds them, and the fit of that effect on it.

    `baseline` has the starts of the current model. Where no effect predicts more than that, it stays.
    `quick`: with those alone that screening promises most of.
    Raises SolverError.
    """
    problem, current = baseline.problem, baseline.current
    others = problem.candidates(current.effects)
    least = _error(baseline.validation.error, current, problem, problem)
    work.share(problem)
    ahead = work.run(screen, [(current, name) for name in others])
    ahead = sorted((s for s in ahead if s.starts and s.gain > 0.0), key=lambda s: -s.gain)
    starts = [_start(problem, current, s.effect, s.starts[0].scaled_values) for s in ahead[:MOST_PROMISING]]
    work.share((dataset, problem))
    holders = [h for h in work.run(held, [(*start, least) for start in starts]) if h is not None]
    below = min((least, *(h.error for h in holders)))
    if below > POLICY.verdict.reached and not quick:
        holding = [name for name in others if any(library[name].has(hook) for hook in HOLDING)]
        tasks = [(*start, below) for name in holding for start in _typical(problem, current, name)]
        holders += [h for h in work.run(held, tasks) if h is not None]
    best = min(holders, key=lambda h: h.error, default=None)
    if best is None or best.error >= least:
        return FoundStarts(problem, baseline, None, {}, least)
    if not quick:
        tried = {h.fit.effects[-1] for h in holders}
        like = [n for n in others if n not in tried and related(library, n, best.fit.effects[-1])]
        tasks = [(*start, least) for name in like for start in _typical(problem, current, name)]
        holders += [h for h in work.run(held, tasks) if h is not None]
        best = min(holders, key=lambda h: h.error)
    # of two starts of one effect the better one
    by_effect = {h.fit.effects[-1]: h for h in sorted(holders, key=lambda h: -h.error)}
    found = FoundStarts(problem, baseline, None, by_effect, least)
    return with_starts_of(best, found, dataset, model, library)


def with_starts_of(
    holder: Holder,
    found: FoundStarts,
    dataset: Dataset,
    model: NeedleModel | None,
    library: Mapping[str, type[Effect]],
) -> FoundStarts:
    """The starts that one effect holds in the place of those that were found. Raises SolverError."""
    shaft = found.problem.model(found.problem.parameters(holder.fit.effects), holder.at)
    renewed = fit_baseline(dataset, model, library, lambda given: judged(given, shaft))
    fitted = over_strength(renewed.problem, holder.fit.effects, holder.fit.vector)
    holders = {**found.holders, holder.fit.effects[-1]: holder}
    return dataclasses.replace(found, baseline=renewed, fit=fitted, holders=holders)


def held(
    shared: tuple[Dataset, Problem], names: tuple[str, ...], vector: ParameterVector, below: float
) -> Holder | None:
    """Starts found with these effects at `vector`, effects fitted to them, and so on until they hold each
    other; the best of the rounds where they never do.

    Only the first round where it does not come `below`. None where the model cannot be solved.
    """
    dataset, problem = shared
    parameters = problem.parameters(names)
    best: Holder | None = None
    last = math.inf
    for _ in range(ROUNDS):
        try:
            shaft = problem.model(parameters, vector)
            here = problem.over([bin_trial(t) for t in judged(dataset, shaft).trials])
            found = over_strength(here, names, vector)
        except (BadInput, SolverError):
            break
        if found is None:
            break
        error = _error(cross_validate(here, found).error, found, here, problem)
        holder = Holder(vector, found, error)
        if abs(error - last) < SAME * error:
            return holder
        best = holder if best is None or error < best.error else best
        if best.error > below:
            break
        vector, last = found.vector, error
    return best


def _start(problem: Problem, current: Fit, name: str, scaled_values: Array) -> Task:
    """The current model with one more effect."""
    parameters = (*current.parameters, *problem.parameters([name]))
    return (*current.effects, name), beside(problem, current, parameters, scaled_values)


def _typical(problem: Problem, current: Fit, name: str) -> list[Task]:
    """An effect beside the current ones at its typical size, either way where it has two."""
    return [_start(problem, current, name, way) for way in either_way(problem.parameters([name]), 1.0)]


def _error(held_out: float, found: Fit, here: Problem, first: Problem) -> float:
    """Root mean square of the residual, in the noise of `first`.

    In that of `here`, which what other starts would change is part of, times the ratio of the two noises'
    geometric means: its logarithm is, up to a constant, −log of the predictive density a value. The error in
    its own noise alone would prefer starts that leave more uncertain.
    """
    in_own = held_out if math.isfinite(held_out) else math.sqrt(found.chi2 / here.size)
    return in_own * math.exp(_log_noise(here) - _log_noise(first))


def _log_noise(problem: Problem) -> float:
    """Logarithm of the noise, mean of all values."""
    return sum(w.log_det for w in problem.whiteners) / (2.0 * problem.size)
