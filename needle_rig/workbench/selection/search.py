"""The search for a set of effects: forward from the current model, sideways over relatives, back again.

Each step takes what the search knows and gives what it knows afterwards; nothing is changed in place.

Several parents are kept at each step, since the first effect found may be the wrong half of a pair. No
effect is known by name here; what looks like what is declared in the effects' own files.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.cross_validation import CrossValidation, cross_validate
from needle_rig.workbench.estimation.map_fit import EXCESS_TOLERANCE, Fit, fit
from needle_rig.workbench.estimation.multistart import (
    fit_without_derivatives,
    over_friction,
    through_valleys,
)
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import ParameterVector, Problem
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.evidence import (
    adjusted_p,
    improves_cross_validation,
    is_negligible,
    size_of,
    within_discretisation_error,
)
from needle_rig.workbench.selection.screening import Screening, Start, beside, screen

EffectSet = frozenset[str]

HALF_AS_GOOD = 0.5
"""Share of the best start's gain from which another start is fitted, and of the promise that a fit should
keep."""
MOST_FITS = 3
"""Starts of an effect that are fitted."""
REFINED = 10
"""Times `search.rough`: a fit whose tolerance is larger than that has ended by it, not early."""
WORSE_FITS = 3.0
"""Tolerances of a fit by which a child may be worse than its parent before it is fitted again."""
NEARLY_OFF = 1e-3
"""Scaled value of an effect that is off but for the tolerance of a fit."""
LIKELY_CHANCE = 0.5
"""p from which a gain is left as it was when a nuisance is added: chance as likely as not."""
MOST_REPLACED = 2
"""Effects of a set that relatives may replace, one after the other."""


@dataclass(frozen=True)
class Candidate:
    """A parent with one more effect."""

    effect: str
    fit: Fit | None
    validation: CrossValidation | None
    screening: Screening


def penalty(problem: Problem) -> float:
    """Price of one parameter in the objective."""
    return float(np.log(POLICY.search.price_times_trials * len(problem.trials)))


def score(problem: Problem, found: Fit) -> float:
    """Objective with its price for parameters; lower is better."""
    return found.objective + penalty(problem) * found.rank


def refinable(problem: Problem, found: Fit) -> bool:
    """Whether a first fit ended early: one that misses by far ends where a refined fit would."""
    return EXCESS_TOLERANCE * excess(problem, found.objective) < REFINED * POLICY.search.rough


def _worth_fitting(ahead: Screening) -> list[Start]:
    """The best start, and those of the next two that promise half as much and more than chance."""
    least = max(HALF_AS_GOOD * ahead.gain, POLICY.search.promising)
    return [*ahead.starts[:1], *(s for s in ahead.starts[1:MOST_FITS] if s.gain > least)]


def try_effect(
    problem: Problem, parent: Fit, effect: str, more: tuple[Start, ...] = (), worth: float = -1.0
) -> Candidate:
    """Fit `effect` on top of `parent` from its best starts, unless screening promises less than `worth`."""
    ahead = screen(problem, parent, effect, worth)
    if ahead.gain < worth and not more:
        return Candidate(effect, None, None, ahead)
    names = (*parent.effects, effect)
    parameters = problem.parameters(names)
    starts = [*more, *_worth_fitting(ahead)]
    best: Fit | None = None
    for start in starts:
        found = fit(
            problem,
            names,
            beside(problem, parent, parameters, start.scaled_values),
            nuisance=parent.nuisance,
            tolerance=POLICY.search.rough,
        )
        if found is not None and (best is None or found.objective < best.objective):
            best = found
    if best is not None and refinable(problem, best):
        if parent.objective - best.objective > POLICY.search.promising:
            best = fit(problem, names, best.vector, nuisance=best.nuisance) or best
        best = through_valleys(problem, best)
    room = 1.0 + WORSE_FITS * EXCESS_TOLERANCE * excess(problem, parent.objective)
    off = best is not None and bool(
        np.all(np.abs(best.vector.scaled_values[len(parent.parameters) :]) < NEARLY_OFF)
    )
    if starts and not off and (best is None or best.objective > parent.objective + room):
        # from the parent's optimum with the effect off nothing can become worse
        idle = np.zeros(len(starts[0].scaled_values))
        retry = fit(problem, names, beside(problem, parent, parameters, idle), nuisance=parent.nuisance)
        hoped = parent.objective - HALF_AS_GOOD * ahead.gain
        if ahead.gain > POLICY.search.promising and (retry is None or retry.objective > hoped):
            retry = (
                fit_without_derivatives(
                    problem, names, beside(problem, parent, parameters, starts[0].scaled_values)
                )
                or retry
            )
        if retry is not None and (best is None or retry.objective < best.objective):
            best = retry
    return Candidate(effect, best, cross_validate(problem, best) if best is not None else None, ahead)


def refit(
    problem: Problem, names: tuple[str, ...], start: ParameterVector
) -> tuple[Fit | None, CrossValidation | None]:
    """Fit from a given parameter vector, with its cross-validation."""
    found = fit(problem, names, start)
    return found, cross_validate(problem, found) if found is not None else None


def from_other_friction(problem: Problem, found: Fit) -> tuple[Fit, CrossValidation | None]:
    """The lowest of a fit and those from other friction, with its cross-validation; None where it stays."""
    best = over_friction(problem, found)
    return best, cross_validate(problem, best) if best is not found else None


def without(found: Fit, effect: str) -> ParameterVector:
    """A fit's parameter vector with one effect taken out."""
    keep = [i for i, a in enumerate(found.parameters) if a.effect != effect]
    return ParameterVector(
        found.vector.log_friction,
        found.vector.log_rigidity,
        found.vector.scaled_values[keep],
        found.vector.trial_friction,
    )


def _silenced(candidate: Candidate, parent: Fit) -> Candidate:
    """A candidate that was not significant before a nuisance was added, at the new parent's objective."""
    if candidate.fit is None:
        return candidate
    level = dataclasses.replace(candidate.fit, objective=parent.objective)
    return Candidate(candidate.effect, level, None, candidate.screening)


@dataclass(frozen=True)
class Step:
    """One move of a search and where it stands after it."""

    kind: Literal["forward", "set aside", "taken out", "back"]
    best: EffectSet
    score: float


@dataclass(frozen=True)
class SearchTrace:
    """State of a search: its fits, all to one problem, and the set `best` at which it stands."""

    problem: Problem
    names: tuple[str, ...]
    """Effects to try."""
    root: Fit
    """The current model's, on top of which effects are added."""
    root_validation: CrossValidation
    best: EffectSet
    fits: Mapping[EffectSet, tuple[Fit, CrossValidation | None]]
    """The best of each set of effects."""
    children: Mapping[EffectSet, tuple[Candidate, ...]]
    """All effects on top of a set."""
    asked: Mapping[EffectSet, float]
    """Screening gain below which `children` of a set were not fitted."""
    negligible: Mapping[str, Fit]
    """Effects that are significant but negligible, with the fit that showed each: they are nuisances."""
    steps: tuple[Step, ...] = ()

    @classmethod
    def begin(
        cls, problem: Problem, names: tuple[str, ...], root: Fit, root_validation: CrossValidation
    ) -> SearchTrace:
        """At the current model."""
        start = frozenset(root.effects)
        return cls(problem, names, root, root_validation, start, {start: (root, root_validation)}, {}, {}, {})

    @property
    def start(self) -> EffectSet:
        """The current model's effects."""
        return frozenset(self.root.effects)

    def score(self, key: EffectSet) -> float:
        """Score of a set that was fitted."""
        return score(self.problem, self.fits[key][0])

    def by_score(self, key: EffectSet) -> tuple[float, list[str]]:
        """Sorting key of a set: score, then names; best first."""
        return self.score(key), sorted(key)

    def passes(self, parent: EffectSet, child: EffectSet) -> bool:
        """Whether the child's extra effects are significant and improve cross-validation."""
        (old, old_validation), (new, new_validation) = self.fits[parent], self.fits[child]
        if adjusted_p(
            old, new, len(self.names)
        ) >= POLICY.evidence.significance or within_discretisation_error(self.problem, old, new):
            return False
        if old_validation is not None and not np.isfinite(old_validation.error):
            return True  # a single command: nothing can be left out, and the report says so
        return improves_cross_validation(old, old_validation, new, new_validation)

    def named(self, key: EffectSet) -> list[str]:
        """Effects of a set that are large enough to matter and were not in the current model."""
        found = self.fits[key][0]
        return [e for e in found.effects if e not in self.start and not is_negligible(found, e)]

    def relatives(self, effect: str) -> list[str]:
        """Effects declared to look like this one, in either file."""
        related = set(self.problem.library[effect].relatives)
        related |= {n for n in self.names if effect in self.problem.library[n].relatives}
        return sorted(related & set(self.names))

    def keep(self, found: Fit | None, validation: CrossValidation | None) -> SearchTrace:
        """The search with a fit added, if it is the best of its set of effects."""
        if found is None:
            return self
        key = frozenset(found.effects)
        old = self.fits.get(key)
        if old is not None and found.objective >= old[0].objective - 1e-9:
            return self
        return dataclasses.replace(self, fits={**self.fits, key: (found, validation)})

    def stepped(self, kind: Literal["forward", "set aside", "taken out", "back"]) -> SearchTrace:
        """The search with one more step, which led to `best`."""
        return dataclasses.replace(self, steps=(*self.steps, Step(kind, self.best, self.score(self.best))))


def search(
    problem: Problem,
    names: tuple[str, ...],
    root: Fit,
    root_validation: CrossValidation,
    *,
    max_effects: int,
    work: Work,
    quick: bool = False,
    known: Fit | None = None,
) -> SearchTrace:
    """Search among `names` on top of `root`, until nothing more passes or more would be named.

    `quick` ends with the best single effect that is large enough to matter; `known` is a fit to the same
    problem with one effect more than `root`, in a valley that this one's signature may not lead to.
    """
    work.share(problem)
    trace = SearchTrace.begin(problem, names, root, root_validation)
    if known is not None:
        trace = trace.keep(known, cross_validate(problem, known))
    frontier = [trace.start]
    if quick:
        trace, options = _forward(trace, work, frontier)
        best = next((key for key in options if trace.named(key)), trace.start)
        trace = _over_friction(trace, work, best)
        return dataclasses.replace(trace, best=best).stepped("forward")
    while True:
        trace, options = _forward(trace, work, frontier)
        if not options:
            break
        chosen = _chosen(trace, options)
        trace = _over_friction(trace, work, chosen)
        move, small = next_move(trace, chosen, max_effects)
        if move == "take out":
            trace = take_out(trace, chosen, small)
            frontier = [trace.best]
        elif move == "set aside":
            trace = set_aside(trace, work, chosen, small)
            frontier = [trace.best]
        elif move == "end":
            break
        else:
            trace, best = _sideways(trace, work, chosen)
            trace = dataclasses.replace(trace, best=best).stepped("forward")
            frontier = _frontier(trace, options, max_effects)
    trace = _back(trace, work)
    return expand(trace, work, trace.best, _least(trace, trace.best))


def _over_friction(trace: SearchTrace, work: Work, key: EffectSet) -> SearchTrace:
    """The search with a set of effects that stays above the noise fitted from other friction, too."""
    found, validation = work.run(from_other_friction, [(trace.fits[key][0],)])[0]
    return trace if validation is None else trace.keep(found, validation)


def next_move(
    trace: SearchTrace, chosen: EffectSet, max_effects: int
) -> tuple[Literal["take out", "set aside", "end", "forward"], str]:
    """The move that follows from the best of the next sets, and its negligible effect ("": none)."""
    found = trace.fits[chosen][0]
    small = next((e for e in sorted(chosen - trace.best) if is_negligible(found, e)), "")
    if small and size_of(found, small) < POLICY.search.no_size:
        return "take out", small
    if small and trace.best <= chosen and len(trace.negligible) < POLICY.search.set_aside:
        return "set aside", small
    return "end" if small or len(trace.named(chosen)) > max_effects else "forward", small


def _frontier(trace: SearchTrace, options: Sequence[EffectSet], max_effects: int) -> list[EffectSet]:
    """Where the search stands, and other sets that come near the best of the `options`."""
    lowest = trace.score(options[0])
    near = lowest + POLICY.search.frontier_share * (trace.score(trace.start) - lowest)
    others = [k for k in options if trace.score(k) < near and k != trace.best]
    if len(trace.named(trace.best)) >= max_effects:
        others = []
    return [trace.best, *others[: POLICY.search.frontier - 1]]


def expand(trace: SearchTrace, work: Work, key: EffectSet, worth: float = -1.0) -> SearchTrace:
    """The search with all effects fitted on top of the set `key`; with `worth` only where screening reaches
    it.

    Screening saves fits on sets that may come to nothing; on a set that comes near the noise, every effect is
    fitted.
    """
    known = {c.effect: c for c in trace.children.get(key, ())}
    before = trace.asked.get(key, np.inf)
    parent = trace.fits[key][0]
    names = [n for n in trace.names if n not in key and n not in trace.negligible]
    wanted = [
        n
        for n in names
        if n not in known or (known[n].fit is None and worth < before and known[n].screening.may_reach(worth))
    ]
    if not wanted:
        return dataclasses.replace(trace, children={**trace.children, key: trace.children.get(key, ())})
    known |= {c.effect: c for c in work.run(try_effect, [(parent, n, (), worth) for n in wanted])}
    found = _from_limits(trace.problem, work, parent, [known[n] for n in names])
    for candidate in found:
        trace = trace.keep(candidate.fit, candidate.validation)
    return dataclasses.replace(
        trace,
        children={**trace.children, key: tuple(found)},
        asked={**trace.asked, key: min(worth, before)},
    )


def _from_limits(problem: Problem, work: Work, parent: Fit, found: Sequence[Candidate]) -> list[Candidate]:
    """Candidates refitted from their special cases where they fit worse than these.

    A special case is an effect that a candidate becomes at an extreme of its parameters.
    """
    fitted = {c.effect: c.fit for c in found if c.fit is not None}
    tasks, places = [], []
    for place, candidate in enumerate(found):
        limits = problem.library[candidate.effect].limits
        known = [(fitted[limit], limit, extremes) for limit, extremes in limits.items() if limit in fitted]
        lowest = min((fit.objective for fit, _, _ in known), default=np.inf)
        if known and (candidate.fit is None or candidate.fit.objective > lowest + POLICY.search.rough):
            starts = tuple(_limit_start(problem, candidate.effect, *k) for k in known)
            tasks.append((parent, candidate.effect, starts))
            places.append(place)
    result = list(found)
    for place, again in zip(places, work.run(try_effect, tasks), strict=True):
        old = found[place].fit
        if again.fit is not None and (old is None or again.fit.objective < old.objective):
            result[place] = again
    return result


def _limit_start(
    problem: Problem, effect: str, known: Fit, limit: str, extremes: Mapping[str, float]
) -> Start:
    """A start at which `effect` equals its fitted special case `limit`.

    Fields of the same name are taken over; the others stand at their `extremes`.
    """
    added = problem.parameters([effect])
    values = {
        (a.field, a.item): a.value(float(x))
        for a, x in zip(known.parameters, known.vector.scaled_values, strict=True)
        if a.effect == limit
    }
    scaled_values = np.zeros(len(added))
    for i, parameter in enumerate(added):
        value = extremes.get(parameter.field, values.get((parameter.field, parameter.item)))
        if value is not None and (value != parameter.info.off or parameter.info.shapes):
            inside = min(max(value, parameter.info.lower), parameter.info.upper)
            scaled_values[i] = np.clip(parameter.scaled_value(inside), *parameter.bounds)
    return Start(scaled_values, np.inf)


def take_out(trace: SearchTrace, key: EffectSet, idle: str) -> SearchTrace:
    """The search with an effect of no size removed from a set: the others are refitted from that lower
    fit."""
    found, _ = trace.fits[key]
    names = tuple(e for e in found.effects if e != idle)
    rest = {k: v for k, v in trace.fits.items() if k != key}
    trace = dataclasses.replace(trace, fits=rest)
    return trace.keep(*refit(trace.problem, names, without(found, idle))).stepped("taken out")


def set_aside(trace: SearchTrace, work: Work, key: EffectSet, effect: str) -> SearchTrace:
    """The search with a significant but negligible effect of the set `key` as a nuisance of that small size.

    It is then not named, and leaves no residual that another effect could fit.
    """
    found = trace.fits[key][0]
    problem = dataclasses.replace(trace.problem, nuisance=_with_direction(trace.problem, found, effect))
    work.share(problem)
    parent = trace.fits[trace.best][0]
    stale = trace.children.get(trace.best, ())
    again = [
        c.effect
        for c in stale
        if c.fit is not None
        and c.effect != effect
        and adjusted_p(parent, c.fit, len(trace.names)) < LIKELY_CHANCE
    ]
    fits: dict[EffectSet, tuple[Fit, CrossValidation | None]] = {
        trace.start: (trace.root, trace.root_validation),
        trace.best: trace.fits[trace.best],
    }
    for fitted, (old, old_validation) in fits.items():
        new, new_validation = refit(problem, old.effects, old.vector)
        if new is None:
            new, new_validation = (
                dataclasses.replace(old, nuisance=np.append(old.nuisance, 0.0)),
                old_validation,
            )
        fits[fitted] = new, new_validation
    root, root_validation = fits[trace.start]
    parent = fits[trace.best][0]
    redone = {c.effect: c for c in work.run(try_effect, [(parent, n) for n in sorted(again)])}
    kept = tuple(redone.get(c.effect) or _silenced(c, parent) for c in stale if c.effect != effect)
    trace = dataclasses.replace(
        trace,
        problem=problem,
        root=root,
        root_validation=root_validation or trace.root_validation,
        fits=fits,
        children={trace.best: kept},
        asked={trace.best: -1.0},
        negligible={**trace.negligible, effect: found},
    )
    for candidate in kept:
        trace = trace.keep(candidate.fit, candidate.validation)
    return trace.stepped("set aside")


def _with_direction(problem: Problem, found: Fit, effect: str) -> tuple[Array, ...]:
    """Nuisances (n, q + 1) a trial with what `effect` does in a fit, at the smallest size that matters."""
    off = found.vector.scaled_values.copy()
    for i, parameter in enumerate(found.parameters):
        if parameter.effect == effect and not parameter.info.shapes:
            off[i] = 0.0
    on = problem.predict(found.parameters, found.vector)
    gone = problem.predict(found.parameters, dataclasses.replace(found.vector, scaled_values=off))
    largest = size_of(found, effect)
    return tuple(
        np.hstack([n, w(a - b)[:, None] / largest])
        for n, w, a, b in zip(problem.nuisance, problem.whiteners, on, gone, strict=True)
    )


def _least(trace: SearchTrace, key: EffectSet) -> float:
    """The screening gain that earns a fit on top of `key`: any at the start and where the noise is near.

    While most of the error is not explained, an effect that promises next to nothing of it is not fitted.
    """
    left = excess(trace.problem, trace.fits[key][0].objective)
    return POLICY.search.faint_share * left if key != trace.start and left > trace.problem.size else -1.0


def asked_beside(gain: float) -> float:
    """Screening gain that earns a fit on a set beside the best one, which an effect improves by `gain`."""
    return max(POLICY.search.beside_gain, POLICY.search.frontier_share * gain)


def _forward(
    trace: SearchTrace, work: Work, frontier: Sequence[EffectSet]
) -> tuple[SearchTrace, list[EffectSet]]:
    """The search with its frontier expanded, and the sets with one effect more that pass, best first."""
    trace = expand(trace, work, frontier[0], _least(trace, frontier[0]))
    fitted = [c.fit.objective for c in trace.children[frontier[0]] if c.fit is not None]
    for key in frontier[1:]:
        needed = trace.fits[key][0].objective - min(fitted, default=np.inf)
        trace = expand(trace, work, key, asked_beside(needed))
    size = len(trace.best) + 1
    options = [k for k in trace.fits if len(k) == size and trace.start <= k and trace.passes(trace.best, k)]
    return trace, sorted(options, key=trace.by_score)


def _chosen(trace: SearchTrace, options: Sequence[EffectSet]) -> EffectSet:
    """The best set, or one that comes close with fewer effects to name."""
    best, *others = options
    close = (k for k in others if trace.score(k) < trace.score(best) + POLICY.search.fewer_named)
    return next((k for k in close if len(trace.named(k)) < len(trace.named(best))), best)


def clearly_lower(after: float, before: float) -> bool:
    """Whether a score is lower by enough to take a relative in an effect's place."""
    return after <= before - POLICY.search.relatives_gain


def _sideways(trace: SearchTrace, work: Work, key: EffectSet) -> tuple[SearchTrace, EffectSet]:
    """The search with each effect's relatives tried in its place, as long as that helps, and the best set."""
    if len(key - trace.start) <= 1:
        return trace, key
    for _ in range(MOST_REPLACED):
        found = trace.fits[key][0]
        tasks = []
        for effect in sorted(key - trace.start):
            rest = key - {effect}
            trace = _with_rest(trace, work, found, effect)
            if rest not in trace.fits:
                continue
            for relative in trace.relatives(effect):
                if relative not in key and rest | {relative} not in trace.fits:
                    tasks.append((trace.fits[rest][0], relative))
        for candidate in work.run(try_effect, tasks):
            trace = trace.keep(candidate.fit, candidate.validation)
        near = [
            k for k in trace.fits if len(k) == len(key) and len(k & key) == len(key) - 1 and trace.start <= k
        ]
        best = min([*near, key], key=trace.by_score)
        if not clearly_lower(trace.score(best), score(trace.problem, found)):
            return trace, key
        key = best
    return trace, key


def _back(trace: SearchTrace, work: Work) -> SearchTrace:
    """The search with effects dropped whose removal still passes (backward elimination)."""
    while len(trace.best - trace.start) > 1:
        found = trace.fits[trace.best][0]
        for effect in sorted(trace.best - trace.start):
            rest = trace.best - {effect}
            trace = _with_rest(trace, work, found, effect)
            if rest in trace.fits and not trace.passes(rest, trace.best):
                trace = dataclasses.replace(trace, best=rest).stepped("back")
                break
        else:
            break
    return trace


def _with_rest(trace: SearchTrace, work: Work, found: Fit, effect: str) -> SearchTrace:
    """The search with a fit's set refitted without one effect."""
    names = tuple(e for e in found.effects if e != effect)
    if frozenset(names) in trace.fits:
        return trace
    return trace.keep(*work.run(refit, [(names, without(found, effect))])[0])
