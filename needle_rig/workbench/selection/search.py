"""The search for a set of effects: forward from the present model, sideways over relatives, back again.

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
from needle_rig.workbench.estimation.cross_validation import HeldOut, held_out
from needle_rig.workbench.estimation.map_fit import LOOSE, Fit, fit
from needle_rig.workbench.estimation.multistart import fit_without_derivatives, through_valleys
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Point, Problem
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.evidence import (
    chance,
    foretells,
    is_negligible,
    may_be_ours,
    size_of,
)
from needle_rig.workbench.selection.screening import Preview, Start, beside, preview

EffectSet = frozenset[str]


@dataclass(frozen=True)
class Candidate:
    """A parent with one more effect."""

    effect: str
    fit: Fit | None
    held: HeldOut | None
    preview: Preview


def penalty(problem: Problem) -> float:
    """Price of one parameter in the objective."""
    return float(np.log(POLICY.search.price_times_trials * len(problem.trials)))


def score(problem: Problem, found: Fit) -> float:
    """Objective with its price for parameters; lower is better."""
    return found.objective + penalty(problem) * found.rank


def refinable(problem: Problem, found: Fit) -> bool:
    """Whether a first fit ended early: one that misses by far ends where a refined one would."""
    return LOOSE * excess(problem, found.objective) < 10 * POLICY.search.rough


def _worth_fitting(ahead: Preview) -> list[Start]:
    """The best start, and those of the next two that promise half as much and more than chance."""
    least = max(0.5 * ahead.gain, POLICY.search.promising)
    return [*ahead.starts[:1], *(s for s in ahead.starts[1:3] if s.gain > least)]


def try_effect(
    problem: Problem, parent: Fit, effect: str, more: tuple[Start, ...] = (), worth: float = -1.0
) -> Candidate:
    """Fit `effect` on top of `parent` from its best starts, unless its preview gains less than `worth`."""
    ahead = preview(problem, parent, effect, worth)
    if ahead.gain < worth and not more:
        return Candidate(effect, None, None, ahead)
    names = (*parent.effects, effect)
    axes = problem.axes(names)
    starts = [*more, *_worth_fitting(ahead)]
    best: Fit | None = None
    for start in starts:
        found = fit(
            problem,
            names,
            beside(problem, parent, axes, start.positions),
            nuisance=parent.nuisance,
            enough=POLICY.search.rough,
        )
        if found is not None and (best is None or found.objective < best.objective):
            best = found
    if best is not None and refinable(problem, best):
        if parent.objective - best.objective > POLICY.search.promising:
            best = fit(problem, names, best.point, nuisance=best.nuisance) or best
        best = through_valleys(problem, best)
    room = 1.0 + 3 * LOOSE * excess(problem, parent.objective)
    off = best is not None and bool(np.all(np.abs(best.point.positions[len(parent.axes) :]) < 1e-3))
    if starts and not off and (best is None or best.objective > parent.objective + room):
        # from the parent's optimum with the effect off nothing can become worse
        idle = np.zeros(len(starts[0].positions))
        retry = fit(problem, names, beside(problem, parent, axes, idle), nuisance=parent.nuisance)
        hoped = parent.objective - 0.5 * ahead.gain
        if ahead.gain > POLICY.search.promising and (retry is None or retry.objective > hoped):
            retry = (
                fit_without_derivatives(problem, names, beside(problem, parent, axes, starts[0].positions))
                or retry
            )
        if retry is not None and (best is None or retry.objective < best.objective):
            best = retry
    return Candidate(effect, best, held_out(problem, best) if best is not None else None, ahead)


def refit(problem: Problem, names: tuple[str, ...], start: Point) -> tuple[Fit | None, HeldOut | None]:
    """Fit from a given point, with its held-out error."""
    found = fit(problem, names, start)
    return found, held_out(problem, found) if found is not None else None


def without(found: Fit, effect: str) -> Point:
    """A fit's point with one effect taken out."""
    keep = [i for i, a in enumerate(found.axes) if a.effect != effect]
    return Point(
        found.point.log_friction,
        found.point.log_rigidity,
        found.point.positions[keep],
        found.point.trial_friction,
    )


def _silenced(candidate: Candidate, parent: Fit) -> Candidate:
    """A candidate that was not seen before a nuisance was added, on the scale of the new parent."""
    if candidate.fit is None:
        return candidate
    level = dataclasses.replace(candidate.fit, objective=parent.objective)
    return Candidate(candidate.effect, level, None, candidate.preview)


@dataclass(frozen=True)
class Step:
    """One move of a search and where it stands after it."""

    kind: Literal["forward", "set aside", "taken out", "back"]
    best: EffectSet
    score: float


@dataclass(frozen=True)
class SearchTrace:
    """What a search knows: all fits are to its problem. `best` is where it stands."""

    problem: Problem
    names: tuple[str, ...]
    """Effects to try."""
    root: Fit
    """The present model's, on top of which effects are added."""
    root_held: HeldOut
    best: EffectSet
    fits: Mapping[EffectSet, tuple[Fit, HeldOut | None]]
    """The best of each set of effects."""
    children: Mapping[EffectSet, tuple[Candidate, ...]]
    """All effects on top of a set."""
    asked: Mapping[EffectSet, float]
    """Preview gain below which `children` of a set were not fitted."""
    negligible: Mapping[str, Fit]
    """Effects that are seen but too small to matter, with the fit that showed each: they are nuisances."""
    steps: tuple[Step, ...] = ()

    @classmethod
    def begin(cls, problem: Problem, names: tuple[str, ...], root: Fit, root_held: HeldOut) -> SearchTrace:
        """At the present model."""
        start = frozenset(root.effects)
        return cls(problem, names, root, root_held, start, {start: (root, root_held)}, {}, {}, {})

    @property
    def start(self) -> EffectSet:
        """The present model's effects."""
        return frozenset(self.root.effects)

    def score(self, key: EffectSet) -> float:
        """Score of a set that was fitted."""
        return score(self.problem, self.fits[key][0])

    def by_score(self, key: EffectSet) -> tuple[float, list[str]]:
        """What sorts sets, best first."""
        return self.score(key), sorted(key)

    def passes(self, parent: EffectSet, child: EffectSet) -> bool:
        """Whether the child's extra effects are seen, and foretell what they have not seen."""
        (old, old_held), (new, new_held) = self.fits[parent], self.fits[child]
        if chance(old, new, len(self.names)) >= POLICY.evidence.significance or may_be_ours(
            self.problem, old, new
        ):
            return False
        if old_held is not None and not np.isfinite(old_held.error):
            return True  # a single command: nothing can be left out, and the report says so
        return foretells(old, old_held, new, new_held)

    def named(self, key: EffectSet) -> list[str]:
        """Effects of a set that are large enough to matter and were not in the present model."""
        found = self.fits[key][0]
        return [e for e in found.effects if e not in self.start and not is_negligible(found, e)]

    def relatives(self, effect: str) -> list[str]:
        """Effects declared to look like this one, in either file."""
        own = set(self.problem.library[effect].relatives)
        own |= {n for n in self.names if effect in self.problem.library[n].relatives}
        return sorted(own & set(self.names))

    def keep(self, found: Fit | None, held: HeldOut | None) -> SearchTrace:
        """With a fit, if it is the best of its set of effects."""
        if found is None:
            return self
        key = frozenset(found.effects)
        old = self.fits.get(key)
        if old is not None and found.objective >= old[0].objective - 1e-9:
            return self
        return dataclasses.replace(self, fits={**self.fits, key: (found, held)})

    def stepped(self, kind: Literal["forward", "set aside", "taken out", "back"]) -> SearchTrace:
        """With one more step, which led to where it stands."""
        return dataclasses.replace(self, steps=(*self.steps, Step(kind, self.best, self.score(self.best))))


def search(
    problem: Problem,
    names: tuple[str, ...],
    root: Fit,
    root_held: HeldOut,
    *,
    max_effects: int,
    work: Work,
) -> SearchTrace:
    """Search among `names` on top of `root`, until nothing more passes or more would be named."""
    work.share(problem)
    trace = SearchTrace.begin(problem, names, root, root_held)
    frontier = [trace.start]
    while True:
        trace, options = _forward(trace, work, frontier)
        if not options:
            break
        chosen = _chosen(trace, options)
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


def next_move(
    trace: SearchTrace, chosen: EffectSet, max_effects: int
) -> tuple[Literal["take out", "set aside", "end", "forward"], str]:
    """What to do with the best of the next sets, and its effect that is too small to matter ("": none)."""
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
    """With all effects on top of the set `key`; with `worth` only those whose preview reaches it.

    A preview orders the work on sets that may come to nothing; on a set that comes near the noise, every
    effect is fitted.
    """
    known = {c.effect: c for c in trace.children.get(key, ())}
    before = trace.asked.get(key, np.inf)
    parent = trace.fits[key][0]
    names = [n for n in trace.names if n not in key and n not in trace.negligible]
    wanted = [
        n
        for n in names
        if n not in known or (known[n].fit is None and worth < before and known[n].preview.may_reach(worth))
    ]
    if not wanted:
        return dataclasses.replace(trace, children={**trace.children, key: trace.children.get(key, ())})
    known |= {c.effect: c for c in work.run(try_effect, [(parent, n, (), worth) for n in wanted])}
    found = _from_limits(trace.problem, work, parent, [known[n] for n in names])
    for candidate in found:
        trace = trace.keep(candidate.fit, candidate.held)
    return dataclasses.replace(
        trace,
        children={**trace.children, key: tuple(found)},
        asked={**trace.asked, key: min(worth, before)},
    )


def _from_limits(problem: Problem, work: Work, parent: Fit, found: Sequence[Candidate]) -> list[Candidate]:
    """Fit again, from the effects that a candidate becomes at an extreme, what fits worse than these."""
    fitted = {c.effect: c.fit for c in found if c.fit is not None}
    tasks, places = [], []
    for place, candidate in enumerate(found):
        limits = problem.library[candidate.effect].limits
        known = [(fitted[limit], limit, extremes) for limit, extremes in limits.items() if limit in fitted]
        lowest = min((fit.objective for fit, _, _ in known), default=np.inf)
        if known and (candidate.fit is None or candidate.fit.objective > lowest + 0.5):
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
    """Where `effect` is the fitted `limit`: fields of the same name taken over, the rest extreme."""
    own = problem.axes([effect])
    values = {
        (a.field, a.item): a.value(float(x))
        for a, x in zip(known.axes, known.point.positions, strict=True)
        if a.effect == limit
    }
    positions = np.zeros(len(own))
    for i, axis in enumerate(own):
        value = extremes.get(axis.field, values.get((axis.field, axis.item)))
        if value is not None and (value != axis.info.off or axis.info.shapes):
            inside = min(max(value, axis.info.lower), axis.info.upper)
            positions[i] = np.clip(axis.position(inside), *axis.bounds)
    return Start(positions, np.inf)


def take_out(trace: SearchTrace, key: EffectSet, idle: str) -> SearchTrace:
    """A fit with an effect of no size in it is a better fit of the others: they are fitted from there."""
    found, _ = trace.fits[key]
    names = tuple(e for e in found.effects if e != idle)
    rest = {k: v for k, v in trace.fits.items() if k != key}
    trace = dataclasses.replace(trace, fits=rest)
    return trace.keep(*refit(trace.problem, names, without(found, idle))).stepped("taken out")


def set_aside(trace: SearchTrace, work: Work, key: EffectSet, effect: str) -> SearchTrace:
    """With an effect of the set `key` that is seen but too small to matter as a nuisance of that small size.

    It then neither earns a name nor leaves a residual that another effect could claim.
    """
    found = trace.fits[key][0]
    problem = dataclasses.replace(trace.problem, nuisance=_with_direction(trace.problem, found, effect))
    work.share(problem)
    parent = trace.fits[trace.best][0]
    stale = trace.children.get(trace.best, ())
    again = [
        c.effect
        for c in stale
        if c.fit is not None and c.effect != effect and chance(parent, c.fit, len(trace.names)) < 0.5
    ]
    fits: dict[EffectSet, tuple[Fit, HeldOut | None]] = {
        trace.start: (trace.root, trace.root_held),
        trace.best: trace.fits[trace.best],
    }
    for fitted, (old, old_held) in fits.items():
        new, new_held = refit(problem, old.effects, old.point)
        if new is None:
            new, new_held = dataclasses.replace(old, nuisance=np.append(old.nuisance, 0.0)), old_held
        fits[fitted] = new, new_held
    root, root_held = fits[trace.start]
    parent = fits[trace.best][0]
    redone = {c.effect: c for c in work.run(try_effect, [(parent, n) for n in sorted(again)])}
    kept = tuple(redone.get(c.effect) or _silenced(c, parent) for c in stale if c.effect != effect)
    trace = dataclasses.replace(
        trace,
        problem=problem,
        root=root,
        root_held=root_held or trace.root_held,
        fits=fits,
        children={trace.best: kept},
        asked={trace.best: -1.0},
        negligible={**trace.negligible, effect: found},
    )
    for candidate in kept:
        trace = trace.keep(candidate.fit, candidate.held)
    return trace.stepped("set aside")


def _with_direction(problem: Problem, found: Fit, effect: str) -> tuple[Array, ...]:
    """Nuisances (n, q + 1) a trial with what `effect` does in a fit, at the smallest size that matters."""
    off = found.point.positions.copy()
    for i, axis in enumerate(found.axes):
        if axis.effect == effect and not axis.info.shapes:
            off[i] = 0.0
    on = problem.predict(found.axes, found.point)
    gone = problem.predict(found.axes, dataclasses.replace(found.point, positions=off))
    largest = size_of(found, effect)
    return tuple(
        np.hstack([n, w(a - b)[:, None] / largest])
        for n, w, a, b in zip(problem.nuisance, problem.whiteners, on, gone, strict=True)
    )


def _least(trace: SearchTrace, key: EffectSet) -> float:
    """The preview gain that earns a fit on top of `key`: any at the start and where the noise is near.

    As long as most of the error is not explained, what promises next to nothing of it cannot be the next.
    """
    left = excess(trace.problem, trace.fits[key][0].objective)
    return POLICY.search.faint_share * left if key != trace.start and left > trace.problem.size else -1.0


def asked_beside(gain: float) -> float:
    """What screening must promise on a set beside the best, where an effect gains `gain`."""
    return max(POLICY.search.beside_gain, POLICY.search.frontier_share * gain)


def _forward(
    trace: SearchTrace, work: Work, frontier: Sequence[EffectSet]
) -> tuple[SearchTrace, list[EffectSet]]:
    """With the frontier expanded; sets with one effect more than where it stands that pass, best first."""
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
    """With each effect's relatives tried in its place, as long as that helps; the best set."""
    if len(key - trace.start) < 2:
        return trace, key
    for _ in range(2):
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
            trace = trace.keep(candidate.fit, candidate.held)
        near = [
            k for k in trace.fits if len(k) == len(key) and len(k & key) == len(key) - 1 and trace.start <= k
        ]
        best = min([*near, key], key=trace.by_score)
        if not clearly_lower(trace.score(best), score(trace.problem, found)):
            return trace, key
        key = best
    return trace, key


def _back(trace: SearchTrace, work: Work) -> SearchTrace:
    """With what is no longer needed dropped."""
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
    """With the set of a fit without one effect fitted."""
    names = tuple(e for e in found.effects if e != effect)
    if frozenset(names) in trace.fits:
        return trace
    return trace.keep(*work.run(refit, [(names, without(found, effect))])[0])
