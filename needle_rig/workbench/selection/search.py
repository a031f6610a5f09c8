"""The search for a set of effects: add, drop and swap, from the current model on.

Each step takes what the search knows and gives what it knows afterwards; nothing is changed in place.

Several parents are kept at each step, since the first effect found may be the wrong half of a pair. No
effect is known by name here; what looks like what is declared in the effects' own files.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.cross_validation import CrossValidation, cross_validate
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.candidates import (
    Candidate,
    fitted,
    refit,
    score,
    screened,
    try_effect,
    without,
)
from needle_rig.workbench.selection.evidence import (
    adjusted_p,
    asked_of,
    has_size,
    improves_cross_validation,
    is_negligible,
    matters,
    predicts,
    size_of,
    within_discretisation_error,
)

EffectSet = frozenset[str]
Move = Literal["forward", "set aside", "taken out", "back", "swapped"]

LIKELY_CHANCE = 0.5
"""p from which a gain is left as it was when a nuisance is added: chance as likely as not."""


def _silenced(candidate: Candidate, parent: Fit) -> Candidate:
    """A candidate that was not significant before a nuisance was added, at the new parent's objective."""
    if candidate.fit is None:
        return candidate
    nuisance = np.append(candidate.fit.nuisance, np.zeros(parent.nuisance.size - candidate.fit.nuisance.size))
    level = dataclasses.replace(candidate.fit, objective=parent.objective, nuisance=nuisance)
    return Candidate(candidate.effect, level, None, candidate.screening)


@dataclass(frozen=True)
class Step:
    """One move of a search and where it stands after it."""

    kind: Move
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
    negligible: Mapping[str, Fit]
    """Effects that are significant but negligible, with the fit that showed each: they are nuisances."""
    steps: tuple[Step, ...] = ()
    laws: Mapping[str, float] = field(default_factory=dict)
    """Laws that no library holds, by the name of each one's effect: what it costs beyond the parameters
    that the data see."""
    laws_tried: int = 0
    """The most that were looked through at once."""

    @classmethod
    def begin(
        cls, problem: Problem, names: tuple[str, ...], root: Fit, root_validation: CrossValidation
    ) -> SearchTrace:
        """At the current model."""
        start = frozenset(root.effects)
        return cls(problem, names, root, root_validation, start, {start: (root, root_validation)}, {}, {})

    @property
    def start(self) -> EffectSet:
        """The current model's effects."""
        return frozenset(self.root.effects)

    def score(self, key: EffectSet) -> float:
        """Score of a set that was fitted."""
        return score(self.problem, self.fits[key][0]) + sum(self.laws.get(effect, 0.0) for effect in key)

    def validation(self, key: EffectSet) -> CrossValidation:
        """Cross-validation of a set that was fitted."""
        return self.fits[key][1] or self.root_validation

    def by_score(self, key: EffectSet) -> tuple[float, list[str]]:
        """Sorting key of a set: score, then names; best first."""
        return self.score(key), sorted(key)

    def passes(self, parent: EffectSet, child: EffectSet) -> bool:
        """Whether the child's extra effects are significant and improve cross-validation."""
        if (child - parent) & self.laws.keys():
            return self._passes_as_law(parent, child)
        (old, old_validation), (new, new_validation) = self.fits[parent], self.fits[child]
        if adjusted_p(
            old, new, len(self.names)
        ) >= POLICY.evidence.significance or within_discretisation_error(self.problem, old, new):
            return False
        if old_validation is not None and not np.isfinite(old_validation.error):
            return True  # a single command: nothing can be left out, and the report says so
        return improves_cross_validation(old_validation, new_validation)

    def beats(self, other: EffectSet, law: EffectSet) -> bool:
        """Whether a set with a law does better than another by what is asked, also at commands left out.

        A law whose model cannot be solved there, as that of a needle that snaps while its damping is still
        missing, is judged with what is found beside it: alone it does not reach the noise.
        """
        if self.score(law) > self.score(other) - asked_of(self.laws_tried):
            return False
        old, new = self.validation(other), self.validation(law)
        return not (np.isfinite(old.error) and np.isfinite(new.error)) or improves_cross_validation(old, new)

    def _passes_as_law(self, parent: EffectSet, child: EffectSet) -> bool:
        """Whether the child's extra law is there: it beats the parent, is large enough to matter, and cannot
        be our own error."""
        old, new = self.validation(parent), self.validation(child)
        solved = np.isfinite(old.error) and np.isfinite(new.error)
        fits = self.fits[parent][0], self.fits[child][0]
        return (
            self.beats(parent, child)
            and (not solved or predicts(self.problem.size, old, new))
            and not within_discretisation_error(self.problem, *fits)
            and matters(self.problem, *fits)
        )

    def named(self, key: EffectSet) -> list[str]:
        """Effects of a set that are large enough to matter and were not in the current model."""
        found = self.fits[key][0]
        return [e for e in found.effects if e not in self.start and not is_negligible(found, e)]

    def best_alone(self) -> Fit | None:
        """The best fit of a single effect of those named, where there are several."""
        named = self.named(self.best)
        alone = [self.start | {e} for e in named if self.start | {e} in self.fits]
        return self.fits[min(alone, key=self.by_score)][0] if len(named) > 1 and alone else None

    def keep(self, found: Fit | None, validation: CrossValidation | None) -> SearchTrace:
        """The search with a fit added, if it is the best of its set of effects."""
        if found is None:
            return self
        key = frozenset(found.effects)
        old = self.fits.get(key)
        if old is not None and found.objective >= old[0].objective - 1e-9:
            return self
        return dataclasses.replace(self, fits={**self.fits, key: (found, validation)})

    def stepped(self, kind: Move) -> SearchTrace:
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
    begin: Fit | None = None,
) -> SearchTrace:
    """Add, drop and swap effects among `names` on top of `root`, until no move passes or more would be named.

    `quick` ends with the best single effect that is large enough to matter, and fits those alone of which
    screening promises most. The search begins at the effects of the fit
    `begin`, or at `root`.
    """
    work.share(problem)
    trace = SearchTrace.begin(problem, names, root, root_validation)
    if begin is not None:
        trace = trace.keep(begin, cross_validate(problem, begin))
    if quick:
        trace = expand(trace, work, trace.start)
        best = next((key for key in _passing(trace) if trace.named(key)), trace.start)
        return dataclasses.replace(trace, best=best).stepped("forward")
    if begin is not None:
        trace = dataclasses.replace(trace, best=frozenset(begin.effects))
    while True:
        trace = back(_added(trace, work, max_effects), work)
        trace, swapped = _swapped(trace, work)
        if swapped == trace.best or any(step.best == swapped for step in trace.steps):
            break
        trace = dataclasses.replace(trace, best=swapped).stepped("swapped")
    return expand(expand(trace, work, trace.start), work, trace.best)


def _added(trace: SearchTrace, work: Work, max_effects: int) -> SearchTrace:
    """The search with effects added, one after the other, until none passes."""
    frontier = [trace.best]
    while True:
        trace, options = _forward(trace, work, frontier)
        if not options:
            return trace
        options = that_matter(trace, options)
        chosen = options[0]
        move, small = next_move(trace, chosen, max_effects)
        if move == "take out":
            trace = take_out(trace, chosen, small)
            frontier = [trace.best]
        elif move == "set aside":
            trace = set_aside(trace, work, chosen, small)
            frontier = [trace.best]
        elif move == "end":
            return trace
        else:
            trace = dataclasses.replace(trace, best=chosen).stepped("forward")
            frontier = _frontier(trace, options, max_effects)


def next_move(
    trace: SearchTrace, chosen: EffectSet, max_effects: int
) -> tuple[Literal["take out", "set aside", "end", "forward"], str]:
    """The move that follows from the best of the next sets, and its negligible effect ("": none)."""
    found = trace.fits[chosen][0]
    small = next((e for e in sorted(chosen - trace.best) if is_negligible(found, e)), "")
    if small and not has_size(found, small):
        return "take out", small
    if small and trace.best <= chosen and len(trace.negligible) < POLICY.search.set_aside:
        return "set aside", small
    return "end" if small or len(trace.named(chosen)) > max_effects else "forward", small


def _frontier(trace: SearchTrace, options: Sequence[EffectSet], max_effects: int) -> list[EffectSet]:
    """Where the search stands, and the next best of the `options`."""
    others = [k for k in options if k != trace.best]
    if len(trace.named(trace.best)) >= max_effects:
        others = []
    return [trace.best, *others[: POLICY.search.frontier - 1]]


def promise_asked(gain: float) -> float:
    """Screening gain that earns an effect a fit where another gains this much.

    A rival ties within `ties.close`, and gains no more than its promise over `screening.kept`.
    """
    return POLICY.screening.kept * max(gain - POLICY.ties.close, 0.0)


def expand(trace: SearchTrace, work: Work, key: EffectSet, gain: float = 0.0) -> SearchTrace:
    """The search with all effects screened on top of the set `key`, and those fitted that may come near the
    one which promises most, and near a `gain`."""
    known = {c.effect: c for c in trace.children.get(key, ())}
    parent = trace.fits[key][0]
    names = [n for n in trace.names if n not in key and n not in trace.negligible]
    known |= {c.effect: c for c in work.run(screened, [(parent, n) for n in names if n not in known])}
    asked = promise_asked(max([gain, *(known[n].screening.gain for n in names)]))
    wanted = [known[n] for n in names if known[n].fit is None and known[n].screening.gain >= asked]
    new = work.run(fitted, [(parent, c) for c in wanted])
    for candidate in new:
        trace = trace.keep(candidate.fit, candidate.validation)
    known |= {c.effect: c for c in new}
    return dataclasses.replace(trace, children={**trace.children, key: tuple(known[n] for n in names)})


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
    for key, (old, old_validation) in list(fits.items()):
        new, new_validation = refit(problem, old.effects, old.vector)
        if new is None:
            new, new_validation = (
                dataclasses.replace(old, nuisance=np.append(old.nuisance, 0.0)),
                old_validation,
            )
        fits[key] = new, new_validation
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


def _forward(
    trace: SearchTrace, work: Work, frontier: Sequence[EffectSet]
) -> tuple[SearchTrace, list[EffectSet]]:
    """The search with its frontier expanded, and the sets with one effect more that pass, best first."""
    trace = expand(trace, work, frontier[0])
    lowest = min((c.fit.objective for c in trace.children[frontier[0]] if c.fit is not None), default=np.inf)
    for key in frontier[1:]:
        trace = expand(trace, work, key, trace.fits[key][0].objective - lowest)
    return trace, _passing(trace)


def _passing(trace: SearchTrace) -> list[EffectSet]:
    """The sets with one effect more that pass, best first."""
    size = len(trace.best) + 1
    options = [k for k in trace.fits if len(k) == size and trace.start <= k and trace.passes(trace.best, k)]
    return sorted(options, key=trace.by_score)


def that_matter(trace: SearchTrace, options: list[EffectSet]) -> list[EffectSet]:
    """The options; where no more can be set aside, those without a new effect too small to matter, if any.

    What is small and far beyond chance stands for something that the library lacks. It must not end a search
    in which something large passes, too.
    """
    if len(trace.negligible) < POLICY.search.set_aside:
        return options
    matter = [
        key
        for key in options
        if not any(is_negligible(trace.fits[key][0], effect) for effect in key - trace.best)
    ]
    return matter or options


def _swapped(trace: SearchTrace, work: Work) -> tuple[SearchTrace, EffectSet]:
    """The search with every effect tried in the place of each that was added, and the best set with one
    swapped; the present one where no swap lowers its score."""
    found = trace.fits[trace.best][0]
    keys = [trace.best]
    for effect in trace.named(trace.best):
        rest = trace.best - {effect}
        if rest not in trace.fits:
            continue
        if rest not in trace.children:
            trace = expand(trace, work, rest, trace.fits[rest][0].objective - found.objective)
        swaps = (rest | {c.effect} for c in trace.children[rest] if c.effect not in trace.best)
        keys += [key for key in swaps if key in trace.fits and trace.passes(rest, key)]
    return trace, min(keys, key=trace.by_score)


def back(trace: SearchTrace, work: Work) -> SearchTrace:
    """The search with effects dropped whose removal still passes (backward elimination)."""
    while trace.best > trace.start:
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
    """The search with a fit's set refitted without one effect; a fit that was silenced counts for none."""
    names = tuple(e for e in found.effects if e != effect)
    key = frozenset(names)
    if key in trace.fits and trace.fits[key][1] is not None:
        return trace
    trace = dataclasses.replace(trace, fits={k: v for k, v in trace.fits.items() if k != key})
    return trace.keep(*work.run(refit, [(names, without(found, effect))])[0])
