"""Which effect is missing: a verdict with its evidence, its rivals and what it cannot tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.coordinates import Coordinate
from needle_rig.workbench.experiment import best_experiment
from needle_rig.workbench.fit import Fit
from needle_rig.workbench.lack_of_fit import LackOfFit, lack_of_fit
from needle_rig.workbench.leftover import Leftover, find_leftover
from needle_rig.workbench.prepare import Prepared, prepare
from needle_rig.workbench.rivals import Rival, find_rivals
from needle_rig.workbench.search import SIGNIFICANCE, Candidate, Search, chance, held_gain, is_trace
from needle_rig.workbench.work import Here, Work

EXPLAINED = 0.8
"""Share of the explainable error below which a library model is never called an explanation."""
WELL_EXPLAINED = 0.97
"""Share above which what is left may be the difference between two codes for the same law."""
SIZE_THAT_MATTERS_DEG = 0.12
SIZE_THAT_MATTERS_NMM = 0.0008

Say = Callable[[str], None]


@dataclass(frozen=True)
class Value:
    """One fitted parameter with its 95 % interval."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    plausible: bool

    def as_json(self) -> dict[str, Any]:
        """As it stands in the JSON answer."""
        return {
            "value": _plain(self.value),
            "unit": self.unit,
            "low": _plain(self.low),
            "high": _plain(self.high),
        }


@dataclass(frozen=True)
class Decision:
    """What can be said of one effect."""

    effect: str
    decision: str
    """present, negligible, absent or cannot_tell."""
    limit: float | None
    """Upper end of the 95 % range of its size, in the unit of `parameter`."""
    parameter: str
    unit: str
    matters_from: float
    downwards: bool = False
    """Whether the effect grows as its parameter falls, as a compliance does given as a stiffness."""

    def sentence(self) -> str:
        """The effect with the limit of its size, in words."""
        if self.limit is None:
            return self.effect
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.effect} ({'>' if self.downwards else '<'} {self.limit:.2g}{unit})"

    def as_json(self) -> dict[str, Any]:
        """As it stands in the JSON answer."""
        return {
            "decision": self.decision,
            "limit": _plain(self.limit),
            "parameter": self.parameter,
            "unit": self.unit,
            "matters_from": _plain(self.matters_from),
        }


@dataclass(frozen=True)
class Ranked:
    """One candidate of the ranking."""

    effect: str
    held_out_error: float | None
    error_removed: float
    values: tuple[Value, ...]
    indistinguishable_from: tuple[str, ...]
    separation_sigma: float | None
    in_favour: str
    against: str

    def as_json(self) -> dict[str, Any]:
        """As it stands in the JSON answer."""
        return {
            "effect": self.effect,
            "held_out_error": _error(self.held_out_error),
            "error_removed": _plain(self.error_removed),
            "parameters": {v.name: v.as_json() for v in self.values},
            "indistinguishable_from": list(self.indistinguishable_from),
            "separation_sigma": _plain(self.separation_sigma),
            "in_favour": self.in_favour,
            "against": self.against,
        }


@dataclass(frozen=True)
class Answer:
    """What `needle-rig diagnose` says, whatever kind of data it was asked of."""

    left_out: ClassVar[str] = "commands"
    """What held-out errors leave out in turn."""

    dataset: str
    model: str
    verdict: str
    effects: tuple[str, ...]
    ranking: tuple[Ranked, ...]
    decisions: dict[str, Decision]
    left_over: Leftover
    explained: bool
    lack_before: LackOfFit | None
    """Whether replicates show anything to explain in the present model; None without replicates."""
    lack_after: LackOfFit | None
    """The same of what the answer leaves."""
    explained_fraction: float
    held_out_error_before: float
    held_out_error_after: float
    noise_floor: float
    next_experiment: dict[str, Any] | None
    notes: tuple[str, ...]

    def left_in_words(self) -> list[str]:
        """What is left: patterns, and what replicates share beyond how they differ."""
        lack = self.lack_after
        shared = [lack.sentence()] if lack is not None and lack.significant else []
        return [p.sentence() for p in self.left_over.patterns] + shared

    def as_json(self) -> dict[str, Any]:
        """The stated form of the answer."""
        return {
            "dataset": self.dataset,
            "model": self.model,
            "verdict": self.verdict,
            "effects": list(self.effects),
            "ranking": [r.as_json() for r in self.ranking],
            "noise_floor": _plain(self.noise_floor),
            "held_out_error_before": _error(self.held_out_error_before),
            "held_out_error_after": _error(self.held_out_error_after),
            "explained_fraction": _plain(self.explained_fraction),
            "decisions": {name: d.as_json() for name, d in self.decisions.items()},
            "left_over": {"explained": self.explained, "where": self.left_in_words()},
            "lack_of_fit": {
                "before": self.lack_before.as_json() if self.lack_before else None,
                "after": self.lack_after.as_json() if self.lack_after else None,
            },
            "next_experiment": self.next_experiment,
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Diagnosis(Answer):
    """The answer on traces, with the fits behind it."""

    prepared: Prepared = field(repr=False)
    search: Search = field(repr=False)


def _too_small(size: float, unit: str) -> bool:
    return size <= (SIZE_THAT_MATTERS_NMM if unit == "N·mm" else SIZE_THAT_MATTERS_DEG)


def _plain(value: float | None) -> float | str | None:
    """JSON has no infinity: it is written as text."""
    if value is None or np.isnan(value):
        return None
    return float(f"{value:.6g}") if np.isfinite(value) else ("inf" if value > 0 else "-inf")


def _error(value: float | None) -> float | None:
    """An error, or None where no command could be left out."""
    return None if value is None or not np.isfinite(value) else float(f"{value:.6g}")


def diagnose(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None = None,
    *,
    max_effects: int = 3,
    seed: int = 0,
    work: Work | None = None,
    say: Say = lambda _: None,
) -> Diagnosis:
    """Hold the present model against a dataset and look for what is missing.

    Raises BadInput when the dataset cannot be used, SolverError when the present model cannot be solved.
    """
    say("measuring the noise, fitting the present model")
    prepared = prepare(dataset, model, library)
    names = tuple(sorted(set(library) - set(prepared.present.effects)))
    with work or Here() as at:
        at.share(prepared.problem)
        search = Search(prepared.problem, names, at, max_effects, prepared.present, prepared.held)
        say("trying every effect")
        search.run()
        say("looking for what cannot be told apart")
        rivals = find_rivals(search, seed)
        return _conclude(prepared, search, rivals, dataset.sensor_names)


def _conclude(
    prepared: Prepared, search: Search, rivals: dict[str, list[Rival]], sensors: tuple[str, ...]
) -> Diagnosis:
    problem = search.problem
    best, held = search.fits[search.best]
    root, root_held = search.root, search.root_held
    named = search.named(search.best)
    left = find_leftover(problem, best, sensors)
    gain = max(0.0, root.objective - best.objective)
    explained_fraction = gain / (gain + left.gain) if gain + left.gain > 0 else 1.0
    if not named:
        explained_fraction = 1.0 if not left.significant else 0.0
    lack = lack_of_fit(problem, best, sensors)
    unexplained = left.significant and any(not _too_small(p.size, p.unit) for p in left.patterns)
    if unexplained and named:
        unexplained = explained_fraction < WELL_EXPLAINED
    if explained_fraction < EXPLAINED and left.significant and named:
        unexplained = True
    if not named and lack is not None and lack.significant and not _too_small(lack.size, lack.unit):
        unexplained = True
    verdict = "unknown" if unexplained else "effect" if named else "none"
    ordered = _order(search, named)
    ranking = _ranking(search, ordered, rivals, verdict)
    ties = [(e, r) for e in ordered for r in rivals.get(e, []) if r.tied]
    experiment = None
    if ties and verdict == "effect":
        effect, rival = ties[0]
        experiment = best_experiment(problem, best, search.fits[rival.key][0], effect, rival.effect, sensors)
    assert held is not None
    return Diagnosis(
        dataset=prepared.dataset.name,
        model=problem.base.name,
        verdict=verdict,
        effects=tuple(ordered) if verdict == "effect" else (),
        ranking=tuple(ranking),
        decisions=_decisions(search, named if verdict == "effect" else []),
        left_over=left,
        explained=not unexplained,
        lack_before=lack_of_fit(prepared.problem, prepared.present, sensors),
        lack_after=lack,
        explained_fraction=explained_fraction,
        held_out_error_before=root_held.error,
        held_out_error_after=held.error if verdict == "effect" else root_held.error,
        noise_floor=1.0,
        next_experiment=experiment,
        notes=(
            *prepared.dataset.notes,
            *prepared.notes,
            *_trace_notes(search),
            *(_preview_notes(search, named) if verdict == "effect" else []),
        ),
        prepared=prepared,
        search=search,
    )


def _order(search: Search, named: list[str]) -> list[str]:
    """Effects in the order of what each would leave unexplained if it were missing."""
    here = search.fits[search.best][0].objective

    def loss(effect: str) -> float:
        rest = frozenset(search.best - {effect})
        return search.fits[rest][0].objective - here if rest in search.fits else np.inf

    return sorted(named, key=lambda e: (-loss(e), e))


def values_of(fit: Fit, effect: str) -> tuple[Value, ...]:
    """Fitted parameters of one effect with their 95 % intervals."""
    found = []
    for axis, at, error in zip(fit.axes, fit.point.positions, fit.position_error, strict=True):
        if axis.effect != effect:
            continue
        ends = [axis.value(float(np.clip(at + s * 1.96 * error, *axis.bounds))) for s in (-1, 1)]
        value = axis.value(float(at))
        low, high = axis.info.literature
        plausible = low <= value <= high or value == axis.info.off
        found.append(Value(axis.name, value, min(ends), max(ends), axis.info.unit, plausible))
    return tuple(found)


def _ranking(
    search: Search, ordered: list[str], rivals: dict[str, list[Rival]], verdict: str
) -> list[Ranked]:
    problem = search.problem
    ranked = []
    root = search.root
    best, held = search.fits[search.best]
    done = set()
    if verdict == "effect":
        for effect in ordered:
            tied = tuple(r.effect for r in rivals[effect] if r.tied)
            rest = search.fits.get(frozenset(search.best - {effect}))
            alone = rest[0].objective - best.objective if rest else np.inf
            apart = [r for r in rivals[effect] if r.separation_sigma is not None]
            ranked.append(
                Ranked(
                    effect,
                    held.error if held else None,
                    _removed(problem, root, best)
                    if len(ordered) == 1
                    else min(1.0, alone / _room(problem, root)),
                    values_of(best, effect),
                    tied,
                    apart[0].separation_sigma if apart else None,
                    _favour(search, best, effect, alone),
                    _against(best, effect, rivals[effect]),
                )
            )
            done.add(effect)
        for effect in ordered:
            for rival in rivals[effect]:
                if rival.tied and rival.effect not in done:
                    found, found_held = search.fits[rival.key]
                    ranked.append(
                        Ranked(
                            rival.effect,
                            found_held.error if found_held else None,
                            _removed(problem, root, found),
                            values_of(found, rival.effect),
                            (effect,),
                            rival.separation_sigma,
                            _favour(search, found, rival.effect, None),
                            _against(found, rival.effect, []) or f"{effect} fits as well",
                        )
                    )
                    done.add(rival.effect)
    others = [c for c in search.children.get(search.start, []) if c.fit is not None and c.effect not in done]
    others.sort(key=lambda c: (c.fit.objective if c.fit else 0.0, c.effect))
    for candidate in others:
        ranked.append(_single(search, candidate))
    return ranked


def _single(search: Search, candidate: Candidate) -> Ranked:
    found = candidate.fit
    assert found is not None
    seen = chance(search.root, found, len(search.names)) < SIGNIFICANCE
    foretells = held_gain(search.root_held, candidate.held) > 0
    removed = _removed(search.problem, search.root, found)
    favour = (
        f"alone it removes {100 * removed:.0f} % of the error above the noise"
        if seen
        else "nothing beyond chance"
    )
    against = "" if seen and foretells else "what it gains does not carry over to commands left out"
    return Ranked(
        candidate.effect,
        candidate.held.error if candidate.held else None,
        removed,
        values_of(found, candidate.effect),
        (),
        None,
        favour,
        against if seen else "a gain like this comes by chance",
    )


def _room(problem: Any, root: Fit) -> float:
    return float(max(root.chi2 - problem.size, 1.0))


def _removed(problem: Any, root: Fit, found: Fit) -> float:
    """Share of the error above the noise that a fit removes, 0 to 1."""
    gain = root.objective - found.objective
    return float(
        np.clip(gain / max(root.objective - min(found.objective, problem.size), gain, 1e-9), 0.0, 1.0)
    )


def _favour(search: Search, found: Fit, effect: str, alone: float | None) -> str:
    removed = 100 * _removed(search.problem, search.root, found)
    sigmas = (
        f"; without it the fit is {np.sqrt(max(alone, 0)):.0f}σ worse" if alone and np.isfinite(alone) else ""
    )
    names = "it" if len(found.effects) - len(search.start) == 1 else "the model with it"
    told = f"{names} removes {removed:.0f} % of the error above the noise and foretells commands left out"
    return told + sigmas


def _against(found: Fit, effect: str, rivals: list[Rival]) -> str:
    parts = [
        f"{v.name} = {v.value:.3g} {v.unit} is outside what is plausible"
        for v in values_of(found, effect)
        if not v.plausible
    ]
    tied = [r for r in rivals if r.tied]
    for rival in tied[:2]:
        apart = "" if rival.separation_sigma is None else f" ({rival.separation_sigma:.1f}σ apart)"
        parts.append(f"{rival.effect} fits as well{apart}")
    if abs(found.pull_rigidity) > 3:
        parts.append(f"the needle's constants are pulled by {found.pull_rigidity:+.1f}σ")
    return "; ".join(parts)


def _preview_notes(search: Search, named: list[str]) -> list[str]:
    """What was not fitted in the place of an effect, since its preview gains too little."""
    notes = []
    here = search.fits[search.best][0].objective
    for effect in named:
        rest = frozenset(search.best - {effect})
        left_out = [
            c
            for c in search.children.get(rest, [])
            if c.fit is None and rest | {c.effect} not in search.fits and c.effect not in search.best
        ]
        if left_out:
            most = max(left_out, key=lambda c: (c.preview.gain, c.effect))
            gain = search.fits[rest][0].objective - here
            notes.append(
                f"In the place of {effect}, {len(left_out)} effects were not refitted: their previews promise"
                f" at most {100 * most.preview.gain / max(gain, 1e-9):.0f} % of its gain ({most.effect})."
            )
    return notes


def _trace_notes(search: Search) -> list[str]:
    notes = []
    for name, (found, _) in search.traces.items():
        said = ", ".join(f"{v.name} = {v.value:.3g} {v.unit}" for v in values_of(found, name))
        notes.append(f"{name} is seen, but too small to matter ({said}).")
    return notes


def _decisions(search: Search, named: list[str]) -> dict[str, Decision]:
    best = search.fits[search.best][0]
    by_name = {c.effect: c for c in search.children.get(search.best, [])}
    decisions = {}
    for name in search.names:
        axes = search.problem.axes([name])
        if name in best.effects:
            decisions[name] = _decision(name, axes, best, "present" if name in named else None)
        elif name in search.traces:
            decisions[name] = _decision(name, axes, search.traces[name][0], "negligible")
        else:
            decisions[name] = _undetected(search, name, axes, best, by_name.get(name))
    return decisions


def _sizes(axes: tuple[Coordinate, ...], found: Fit, name: str) -> list[tuple[Coordinate, float, float]]:
    return [
        (a, float(x), float(e))
        for a, x, e in zip(found.axes, found.point.positions, found.position_error, strict=True)
        if a.effect == name and not a.info.shapes
    ]


def _decision(name: str, axes: tuple[Coordinate, ...], found: Fit, fixed: str | None) -> Decision:
    sizes = _sizes(axes, found, name)
    axis, at, error = max(sizes, key=lambda s: (abs(s[1]) + 1.645 * s[2]) / max(s[0].smallest, 1e-9))
    limit = abs(at) + 1.645 * error
    below = all(abs(x) + 1.645 * e < a.smallest for a, x, e in sizes)
    return decision_at(name, axis, limit, fixed or ("absent" if below else "cannot_tell"), at)


def decision_at(name: str, axis: Coordinate, limit: float, decision: str, at: float) -> Decision:
    """The decision on the effect whose size, `limit` at most, is measured along `axis`; it stands at `at`."""
    low, high = axis.bounds
    way = (1.0 if at > 0 else -1.0) if at else (1.0 if high > 0 else -1.0)
    value = axis.value(float(np.clip(way * limit, low, high)))
    if axis.info.scale == "linear":
        value = abs(value - axis.info.off)
        return Decision(name, decision, value, axis.field, axis.info.unit, _smallest_size(axis))
    downwards = axis.info.off > axis.info.typical
    return Decision(name, decision, value, axis.field, axis.info.unit, axis.info.smallest, downwards)


def _smallest_size(axis: Coordinate) -> float:
    return abs(axis.info.smallest - axis.info.off)


def _undetected(
    search: Search, name: str, axes: tuple[Coordinate, ...], best: Fit, candidate: Candidate | None
) -> Decision:
    strength = next(a for a in axes if not a.info.shapes)
    if candidate is None:
        return decision_at(name, strength, np.inf, "cannot_tell", 0.0)
    found = candidate.fit
    if found is None or not np.all(np.isfinite(found.position_error)):
        limit = candidate.preview.estimate + 1.645 * candidate.preview.error
        return decision_at(
            name, strength, limit, "absent" if limit < strength.smallest else "cannot_tell", 0.0
        )
    decided = _decision(name, axes, found, None)
    if chance(best, found, len(search.names)) < SIGNIFICANCE:
        fixed = "negligible" if is_trace(found, name) else "cannot_tell"
        return _decision(name, axes, found, fixed)
    return decided
