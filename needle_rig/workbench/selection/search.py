"""The search for a set of effects: forward from the present model, sideways over relatives, back again.

Several parents are kept at each step, since the first effect found may be the wrong half of a pair. No
effect is known by name here; what looks like what is declared in the effects' own files.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from needle_rig.workbench.estimation.cross_validation import HeldOut, held_out
from needle_rig.workbench.estimation.map_fit import LOOSE, Fit, fit
from needle_rig.workbench.estimation.multistart import fit_without_derivatives, through_valleys
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Point, Problem
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.selection.evidence import (
    SIGNIFICANCE,
    chance,
    foretells,
    is_trace,
    may_be_ours,
    size_of,
)
from needle_rig.workbench.selection.screening import Preview, Start, beside, preview

FRONTIER = 3
TRACE_PREFERENCE = 8.0
ROUGH = 0.5
"""First fits end when the next step would gain less than this;"""
PROMISING = 4.0
"""those that gain more than this are refined."""
MOST_TRACES = 2
IDLE = 1e-3
"""Share of the smallest size that matters below which an effect has no size."""
FAINT = 0.1
"""Share of a large error that an effect must promise to earn a fit."""


@dataclass(frozen=True)
class Candidate:
    """A parent with one more effect."""

    effect: str
    fit: Fit | None
    held: HeldOut | None
    preview: Preview


def penalty(problem: Problem) -> float:
    """Price of one parameter in the objective: ln(5 · trials)."""
    return float(np.log(5 * len(problem.trials)))


def score(problem: Problem, found: Fit) -> float:
    """Objective with its price for parameters; lower is better."""
    return found.objective + penalty(problem) * found.rank


def refinable(problem: Problem, found: Fit) -> bool:
    """Whether a first fit ended early: one that misses by far ends where a refined one would."""
    return LOOSE * excess(problem, found.objective) < 10 * ROUGH


def try_effect(
    problem: Problem, parent: Fit, effect: str, more: tuple[Start, ...] = (), worth: float = -1.0
) -> Candidate:
    """Fit `effect` on top of `parent` from its best starts, unless its preview gains less than `worth`."""
    ahead = preview(problem, parent, effect, worth)
    if ahead.gain < worth and not more:
        return Candidate(effect, None, None, ahead)
    names = (*parent.effects, effect)
    axes = problem.axes(names)
    starts = [*more, *ahead.starts[:1]]
    starts += [s for s in ahead.starts[1:3] if s.gain > max(0.5 * ahead.gain, PROMISING)]
    best: Fit | None = None
    for start in starts:
        found = fit(
            problem,
            names,
            beside(problem, parent, axes, start.positions),
            nuisance=parent.nuisance,
            enough=ROUGH,
        )
        if found is not None and (best is None or found.objective < best.objective):
            best = found
    if best is not None and refinable(problem, best):
        if parent.objective - best.objective > PROMISING:
            best = fit(problem, names, best.point, nuisance=best.nuisance) or best
        best = through_valleys(problem, best)
    room = 1.0 + 3 * LOOSE * excess(problem, parent.objective)
    off = best is not None and bool(np.all(np.abs(best.point.positions[len(parent.axes) :]) < 1e-3))
    if starts and not off and (best is None or best.objective > parent.objective + room):
        # from the parent's optimum with the effect off nothing can become worse
        idle = np.zeros(len(starts[0].positions))
        retry = fit(problem, names, beside(problem, parent, axes, idle), nuisance=parent.nuisance)
        hoped = parent.objective - 0.5 * ahead.gain
        if ahead.gain > PROMISING and (retry is None or retry.objective > hoped):
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


@dataclass
class Search:
    """Progress and result of a search; `best` is where it stands."""

    problem: Problem
    names: tuple[str, ...]
    work: Work
    max_effects: int
    root: Fit
    root_held: HeldOut
    fits: dict[frozenset[str], tuple[Fit, HeldOut | None]] = field(default_factory=dict)
    children: dict[frozenset[str], list[Candidate]] = field(default_factory=dict)
    steps: list[frozenset[str]] = field(default_factory=list)
    best: frozenset[str] = frozenset()
    traces: dict[str, tuple[Fit, frozenset[str]]] = field(default_factory=dict)
    """Effects that are seen but too small to matter, with the fit that showed each."""
    asked: dict[frozenset[str], float] = field(default_factory=dict)
    """Preview gain below which `children` of a set were not fitted."""

    def __post_init__(self) -> None:
        self.start = frozenset(self.root.effects)
        self.best = self.start
        self.fits[self.start] = (self.root, self.root_held)

    def keep(self, found: Fit | None, held: HeldOut | None) -> None:
        """Remember a fit if it is the best of its set of effects."""
        if found is None:
            return
        key = frozenset(found.effects)
        old = self.fits.get(key)
        if old is None or found.objective < old[0].objective - 1e-9:
            self.fits[key] = (found, held)

    def expand(self, key: frozenset[str], worth: float = -1.0) -> list[Candidate]:
        """All effects on top of the set `key`; with `worth` only those whose preview reaches it.

        A preview orders the work on sets that may come to nothing; on a set that comes near the noise, every
        effect is fitted.
        """
        known = {c.effect: c for c in self.children.get(key, [])}
        before = self.asked.get(key, np.inf)
        parent = self.fits[key][0]
        names = [n for n in self.names if n not in key and n not in self.traces]
        wanted = [
            n
            for n in names
            if n not in known
            or (known[n].fit is None and worth < before and known[n].preview.may_reach(worth))
        ]
        if not wanted:
            return self.children.setdefault(key, [])
        known |= {c.effect: c for c in self.work.run(try_effect, [(parent, n, (), worth) for n in wanted])}
        found = self._from_limits(parent, [known[n] for n in names])
        for candidate in found:
            self.keep(candidate.fit, candidate.held)
        self.children[key], self.asked[key] = found, min(worth, before)
        return found

    def _from_limits(self, parent: Fit, found: list[Candidate]) -> list[Candidate]:
        """Fit again, from the effects that a candidate becomes at an extreme, what fits worse than these."""
        fitted = {c.effect: c.fit for c in found if c.fit is not None}
        tasks, places = [], []
        for place, candidate in enumerate(found):
            limits = self.problem.library[candidate.effect].limits
            known = [
                (fitted[limit], limit, extremes) for limit, extremes in limits.items() if limit in fitted
            ]
            lowest = min((fit.objective for fit, _, _ in known), default=np.inf)
            if known and (candidate.fit is None or candidate.fit.objective > lowest + 0.5):
                tasks.append(
                    (parent, candidate.effect, tuple(self._limit_start(candidate.effect, *k) for k in known))
                )
                places.append(place)
        result = list(found)
        for place, again in zip(places, self.work.run(try_effect, tasks), strict=True):
            old = found[place].fit
            if again.fit is not None and (old is None or again.fit.objective < old.objective):
                result[place] = again
        return result

    def _limit_start(self, effect: str, known: Fit, limit: str, extremes: dict[str, float]) -> Start:
        """Where `effect` is the fitted `limit`: fields of the same name taken over, the rest extreme."""
        own = self.problem.axes([effect])
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

    def passes(self, parent: frozenset[str], child: frozenset[str]) -> bool:
        """Whether the child's extra effects are seen, and foretell what they have not seen."""
        (old, old_held), (new, new_held) = self.fits[parent], self.fits[child]
        if chance(old, new, len(self.names)) >= SIGNIFICANCE or may_be_ours(self.problem, old, new):
            return False
        if old_held is not None and not np.isfinite(old_held.error):
            return True  # a single command: nothing can be left out, and the report says so
        return foretells(old, old_held, new, new_held)

    def named(self, key: frozenset[str]) -> list[str]:
        """Effects of a set that are large enough to matter and were not in the present model."""
        found = self.fits[key][0]
        return [e for e in found.effects if e not in self.start and not is_trace(found, e)]

    def _take_over(self, key: frozenset[str], idle: str) -> None:
        """A fit with an effect of no size in it is a better fit of the others."""
        found, _ = self.fits.pop(key)
        names = tuple(e for e in found.effects if e != idle)
        self.keep(*refit(self.problem, names, without(found, idle)))

    def _set_aside(self, key: frozenset[str], trace: str) -> None:
        """Turn an effect that is seen but too small to matter into a nuisance direction of that small size.

        It then neither earns a name nor leaves a residual that another effect could claim.
        """
        found = self.fits[key][0]
        self.traces[trace] = (found, self.best)
        point = found.point
        positions = point.positions.copy()
        off = positions.copy()
        for i, axis in enumerate(found.axes):
            if axis.effect == trace and not axis.info.shapes:
                off[i] = 0.0
        largest = size_of(found, trace)
        on = self.problem.predict(found.axes, point)
        bare = dataclasses.replace(point, positions=off)
        gone = self.problem.predict(found.axes, bare)
        column = [
            self.problem.whiteners[t](a - b)[:, None] / largest
            for t, (a, b) in enumerate(zip(on, gone, strict=True))
        ]
        joined = tuple(np.hstack([n, c]) for n, c in zip(self.problem.nuisance, column, strict=True))
        self.problem = dataclasses.replace(self.problem, nuisance=joined)
        self.work.share(self.problem)
        again = {c.effect for c in self.children.get(self.best, []) if self._worth_again(c)}
        stale = self.children.get(self.best, [])
        kept_fits = {self.start: (self.root, self.root_held), self.best: self.fits[self.best]}
        self.fits, self.children = {}, {}
        for key, (old, old_held) in kept_fits.items():
            new, new_held = refit(self.problem, old.effects, old.point)
            if new is None:
                new, new_held = dataclasses.replace(old, nuisance=np.append(old.nuisance, 0.0)), old_held
            self.fits[key] = new, new_held
        self.root, root_held = self.fits[self.start]
        self.root_held = root_held or self.root_held
        parent = self.fits[self.best][0]
        redone = {
            c.effect: c for c in self.work.run(try_effect, [(parent, n) for n in sorted(again - {trace})])
        }
        kept = [redone.get(c.effect) or _silenced(c, parent) for c in stale if c.effect != trace]
        for candidate in kept:
            self.keep(candidate.fit, candidate.held)
        self.children[self.best], self.asked = kept, {self.best: -1.0}

    def _worth_again(self, candidate: Candidate) -> bool:
        parent = self.fits[self.best][0]
        return candidate.fit is not None and chance(parent, candidate.fit, len(self.names)) < 0.5

    def run(self) -> frozenset[str]:
        """Search until nothing more passes; returns the best set."""
        frontier = [self.start]
        while True:
            options = self._forward(frontier)
            if not options:
                break
            chosen = options[0]
            lowest = score(self.problem, self.fits[chosen][0])
            for other in options[1:]:
                close = score(self.problem, self.fits[other][0]) < lowest + TRACE_PREFERENCE
                if close and len(self.named(other)) < len(self.named(chosen)):
                    chosen = other
                    break
            trace = [e for e in chosen - self.best if is_trace(self.fits[chosen][0], e)]
            if trace and size_of(self.fits[chosen][0], trace[0]) < IDLE:
                self._take_over(chosen, trace[0])
                frontier = [self.best]
                continue
            if trace and self.best <= chosen and len(self.traces) < MOST_TRACES:
                self._set_aside(chosen, trace[0])
                frontier = [self.best]
                continue
            if len(self.named(chosen)) > self.max_effects or trace:
                break
            self.best = self._sideways(chosen)
            self.steps.append(self.best)
            spread = score(self.problem, self.fits[self.start][0]) - lowest
            near = [k for k in options if score(self.problem, self.fits[k][0]) < lowest + 0.6 * spread]
            others = (
                [k for k in near if k != self.best] if len(self.named(self.best)) < self.max_effects else []
            )
            frontier = [self.best, *others[: FRONTIER - 1]]
        self.best = self._back(self.best)
        self.expand(self.best, self._least(self.best))
        return self.best

    def _least(self, key: frozenset[str]) -> float:
        """The preview gain that earns a fit on top of `key`: any at the start and where the noise is near.

        As long as most of the error is not explained, what promises next to nothing of it cannot be the next.
        """
        left = excess(self.problem, self.fits[key][0].objective)
        return FAINT * left if key != self.start and left > self.problem.size else -1.0

    def _forward(self, frontier: list[frozenset[str]]) -> list[frozenset[str]]:
        """Sets with one effect more than where the search stands that pass, best first."""
        self.expand(frontier[0], self._least(frontier[0]))
        best_child = min(
            (c.fit.objective for c in self.children[frontier[0]] if c.fit is not None), default=np.inf
        )
        for key in frontier[1:]:
            needed = self.fits[key][0].objective - best_child
            self.expand(key, worth=max(12.0, 0.6 * needed))
        size = len(self.best)
        options = [
            k for k in self.fits if len(k) == size + 1 and self.start <= k and self.passes(self.best, k)
        ]
        return sorted(options, key=lambda k: (score(self.problem, self.fits[k][0]), sorted(k)))

    def _sideways(self, key: frozenset[str]) -> frozenset[str]:
        """Each effect's relatives in its place, as long as that helps."""
        if len(key - self.start) < 2:
            return key
        for _ in range(2):
            found = self.fits[key][0]
            tasks, sets = [], []
            for effect in sorted(key - self.start):
                rest = frozenset(key - {effect})
                if rest not in self.fits:
                    names = tuple(e for e in found.effects if e != effect)
                    self.keep(*self.work.run(refit, [(names, without(found, effect))])[0])
                if rest not in self.fits:
                    continue
                for relative in self.relatives(effect):
                    other = rest | {relative}
                    if relative not in key and other not in self.fits:
                        tasks.append((self.fits[rest][0], relative))
                        sets.append(other)
            for candidate in self.work.run(try_effect, tasks):
                self.keep(candidate.fit, candidate.held)
            near = [
                k
                for k in self.fits
                if len(k) == len(key) and len(k & key) == len(key) - 1 and self.start <= k
            ]
            best = min([*near, key], key=lambda k: (score(self.problem, self.fits[k][0]), sorted(k)))
            if score(self.problem, self.fits[best][0]) > score(self.problem, found) - 2.0:
                return key
            key = best
        return key

    def relatives(self, effect: str) -> list[str]:
        """Effects declared to look like this one, in either file."""
        own = set(self.problem.library[effect].relatives)
        own |= {n for n in self.names if effect in self.problem.library[n].relatives}
        return sorted(own & set(self.names))

    def _back(self, key: frozenset[str]) -> frozenset[str]:
        """Drop what is no longer needed."""
        while len(key - self.start) > 1:
            found = self.fits[key][0]
            dropped = None
            for effect in sorted(key - self.start):
                rest = frozenset(key - {effect})
                if rest not in self.fits:
                    names = tuple(e for e in found.effects if e != effect)
                    self.keep(*self.work.run(refit, [(names, without(found, effect))])[0])
                if rest in self.fits and not self.passes(rest, key):
                    dropped = rest
                    break
            if dropped is None:
                return key
            key = dropped
        return key
