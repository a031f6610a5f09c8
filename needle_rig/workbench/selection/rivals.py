"""Rivals: effects that fit in the place of one that was found, whether they tie, and their separation."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.candidates import score
from needle_rig.workbench.selection.search import EffectSet, SearchTrace, expand

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
    tied: bool
    separation_sigma: float | None = None
    """Separation of the rival from what was found, in σ; None where it was not computed."""


def cannot_be_told_apart(behind: float, *, gain_over_special: float | None = None) -> bool:
    """Whether an explanation ties with the best one, whose score is lower by `behind`.

    A generalisation of another close explanation ties only if its gain over that special case is itself as
    large as tells two apart.
    """
    if gain_over_special is not None and gain_over_special < POLICY.ties.close:
        return False
    return behind < POLICY.ties.close


def separation(problem: Problem, truth: Fit, rival: Fit) -> float:
    """How many σ apart the rival's best fit to the noise-free prediction of `truth` would be."""
    perfect = problem.with_means(problem.predict(truth.parameters, truth.vector))
    found = fit(perfect, rival.effects, rival.vector, nuisance=rival.nuisance)
    return float(np.sqrt(found.chi2)) if found is not None else float("inf")


def find_rivals(search: SearchTrace, work: Work) -> tuple[SearchTrace, dict[str, list[Rival]]]:
    """The search with every effect tried in the place of each that was found; its rivals, closest first."""
    problem, best = search.problem, search.best
    here = search.fits[best][0]
    found: dict[str, list[Rival]] = {}
    for effect in search.named(best):
        rest = best - {effect}
        if rest in search.fits and rest not in search.children:
            gain = search.fits[rest][0].objective - here.objective
            search = expand(search, work, rest, gain)
        rivals = []
        for candidate in search.children.get(rest, ()):
            key = rest | {candidate.effect}
            if candidate.effect == effect or candidate.effect in best or key not in search.fits:
                continue
            other = search.fits[key][0]
            if not search.passes(rest, key):
                continue
            behind = score(problem, other) - score(problem, here)
            general = effect in problem.library[candidate.effect].limits
            tied = cannot_be_told_apart(
                behind,
                gain_over_special=here.objective - other.objective if general else None,
            )
            rivals.append(Rival(candidate.effect, key, behind, tied))
        rivals.sort(key=lambda r: (r.behind, r.effect))
        for place, rival in enumerate(rivals[:SEPARATED]):
            if rival.tied or (place == 0 and rival.behind < TOLD_BEHIND):
                apart = separation(problem, here, search.fits[rival.key][0])
                rivals[place] = dataclasses.replace(rival, separation_sigma=apart)
        found[effect] = rivals
    return search, found
