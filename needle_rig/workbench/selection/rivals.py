"""Rivals: effects that fit in the place of one that was found, whether they tie, and their separation."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from needle_rig.workbench.estimation.map_fit import Fit, fit
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.candidates import score
from needle_rig.workbench.selection.search import EffectSet, SearchTrace, expand, promise_asked
from needle_rig.workbench.selection.unknown_starts import FoundStarts, Holder

DRAWS = 400
"""Reweightings: a share of 0.8 is then known to 0.02."""
TOLD_BEHIND = 400.0
"""Score behind (20σ) up to which the separation of the closest rival is computed."""
SEPARATED = 2
"""Rivals whose separation is computed, the closest first."""


@dataclass(frozen=True)
class Rival:
    """Another effect in the place of one that was found."""

    effect: str
    key: EffectSet
    behind: float
    """Score of the rival over that of what was found."""
    share: float
    """Share of reweightings of the trials in which what was found stays ahead."""
    tied: bool
    separation_sigma: float | None = None
    """Separation of the rival from what was found, in σ; None where it was not computed."""
    held: Holder | None = None
    """From the starts that the rival finds itself, where it ties from those."""


def cannot_be_told_apart(
    behind: float, *, missed: float = 0.0, share: float = 1.0, gain_over_special: float | None = None
) -> bool:
    """Whether an explanation ties with the best one, whose −2 log posterior is lower by `behind`.

    The tolerance grows by what the best one misses above the noise (`missed`), and by a factor where the best
    one is ahead in too small a `share` of reweightings of the trials. A generalisation of another close
    explanation ties only if its gain over that special case is itself as large as tells two apart.
    """
    if gain_over_special is not None and gain_over_special < POLICY.ties.close:
        return False
    near = POLICY.ties.close + missed
    return behind < near or (share < POLICY.ties.sure_share and behind < POLICY.ties.unsure * near)


def bootstrap_share(problem: Problem, first: Fit, other: Fit, seed: int) -> float:
    """Share of random reweightings of the trials (Bayesian bootstrap) in which `first` stays ahead."""
    generator = np.random.default_rng(seed)
    trials = len(problem.trials)
    weights = generator.dirichlet(np.ones(trials), DRAWS) * trials
    priors = (other.objective - other.trial_loss.sum()) - (first.objective - first.trial_loss.sum())
    price = score(problem, other) - other.objective - (score(problem, first) - first.objective)
    # sorted, so that the order in which trials are listed changes nothing
    ahead = weights @ np.sort(other.trial_loss - first.trial_loss) + priors + price
    return float(np.mean(ahead > 0))


def separation(problem: Problem, truth: Fit, rival: Fit) -> float:
    """How many σ apart the rival's best fit to the noise-free prediction of `truth` would be."""
    perfect = problem.with_means(problem.predict(truth.parameters, truth.vector))
    found = fit(perfect, rival.effects, rival.vector, nuisance=rival.nuisance)
    return float(np.sqrt(found.chi2)) if found is not None else float("inf")


def find_rivals(
    search: SearchTrace, work: Work, seed: int, starts: FoundStarts | None = None
) -> tuple[SearchTrace, dict[str, list[Rival]]]:
    """The search with every effect tried in the place of each that was found; its rivals, closest first.

    Where the effect alone was found and the shaft's `starts` are its own, each of the others is held against
    it from starts of its own, too.
    """
    problem, best = search.problem, search.best
    here = search.fits[best][0]
    found: dict[str, list[Rival]] = {}
    for effect in search.named(best):
        rest = best - {effect}
        if rest in search.fits and rest not in search.children:
            gain = search.fits[rest][0].objective - here.objective
            search = expand(search, work, rest, promise_asked(gain))
        behind_own = starts.behind(effect) if starts is not None and search.named(best) == [effect] else {}
        as_well = {
            name
            for name, behind in behind_own.items()
            if cannot_be_told_apart(behind) and effect not in problem.library[name].limits
        }
        if any(rest | {name} not in search.fits for name in as_well):
            search = expand(search, work, rest)
        rivals = []
        for candidate in search.children.get(rest, ()):
            key = rest | {candidate.effect}
            if candidate.effect == effect or candidate.effect in best or key not in search.fits:
                continue
            other = search.fits[key][0]
            held = starts.holders[candidate.effect] if starts and candidate.effect in as_well else None
            if held is None and not search.passes(rest, key):
                continue
            behind = score(problem, other) - score(problem, here)
            share = bootstrap_share(problem, here, other, seed)
            general = effect in problem.library[candidate.effect].limits
            tied = cannot_be_told_apart(
                behind,
                missed=excess(problem, here.chi2),
                share=share,
                gain_over_special=here.objective - other.objective if general else None,
            )
            if held is not None:
                behind, tied = min(behind, behind_own[candidate.effect]), True
            rivals.append(Rival(candidate.effect, key, behind, share, tied, held=held))
        rivals.sort(key=lambda r: (r.behind, r.effect))
        for place, rival in enumerate(rivals[:SEPARATED]):
            if rival.held is not None:
                continue  # from one start for both
            if rival.tied or (place == 0 and rival.behind < TOLD_BEHIND):
                apart = separation(problem, here, search.fits[rival.key][0])
                rivals[place] = dataclasses.replace(rival, separation_sigma=apart)
        found[effect] = rivals
    return search, found
