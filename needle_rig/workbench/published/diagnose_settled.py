"""Which effect is missing, asked of settled values: the same answer as on traces, from a few numbers.

Few numbers leave ties (see `single_effects`); among effects that tie, plausibility gives the order, and what
would tell them apart is computed. One effect is added at a time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from needle_rig.dataset.settled import SettledData
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.published.design import next_experiment
from needle_rig.workbench.published.explanation import explanation, scatter_by_quantity
from needle_rig.workbench.published.fit import (
    SettledFit,
    SettledProblem,
    held_out_error,
    separation,
)
from needle_rig.workbench.published.single_effects import (
    Candidate,
    effect_parameters,
    fits_of,
    settled_problem,
    tied_effects,
    try_effect,
)
from needle_rig.workbench.selection.answer import SIGMAS_95, Answer, Decision, Ranked, Say, Value
from needle_rig.workbench.selection.decisions import decision_at
from needle_rig.workbench.selection.documents import Verdict
from needle_rig.workbench.selection.explanation import Explanation
from needle_rig.workbench.selection.residual_patterns import Pattern, ResidualPatterns
from needle_rig.workbench.selection.values import spelt_sigmas
from needle_rig.workbench.selection.verdict import Reason

UNUSUAL = 1.0
"""Pull (σ) from which a parameter is said to lie near the edge of what is plausible."""
MISSED = 2.0
"""Values further than this from the model, in standard errors, are named as residual patterns."""


@dataclass(frozen=True)
class SettledAnswer(Answer):
    """The answer on settled values, with the fits behind it."""

    left_out = "motions"

    problem: SettledProblem = field(repr=False)
    root: SettledFit = field(repr=False)
    """The fit of the current model."""
    tied: tuple[SettledFit, ...] = field(repr=False)
    """The fits of effects that tie, most plausible first."""

    @property
    def noise(self) -> dict[str, float]:
        """Standard error of a value, by quantity, in the unit that its name ends in."""
        return scatter_by_quantity(self.problem)

    def explanations(self) -> tuple[Explanation, ...]:
        """What can be adopted: the named effect, then each tie in its place; none without an effect."""
        return tuple(explanation(self.problem, self.root, found) for found in self.tied)


def diagnose_settled(
    data: SettledData,
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None = None,
    *,
    say: Say = lambda _: None,
) -> SettledAnswer:
    """Hold the current model against settled values and look for the one effect that is missing.

    Raises BadInput, with file and line, for a sequence that cannot be run.
    """
    say("fitting the current model")
    problem, root = settled_problem(data, library, model)
    say("trying every effect")
    # settled values are too few for a place that is looked for
    placed = {name for name, effect in problem.library.items() if effect.is_placed()}
    names = tuple(sorted(set(problem.library) - placed - set(root.effects)))
    tried = [try_effect(problem, root, name, len(names)) for name in names]
    tied = tied_effects(problem, tried)
    missing = bool(tied) or root.p_value <= POLICY.evidence.significance
    say("looking for what would tell them apart")
    verdict: Verdict = "none" if not missing else "effect" if tied else "unknown"
    why = (Reason("no_effect_meets_the_values", _no_effect(problem, root)),) if verdict == "unknown" else ()
    best = tied[0].fit if tied and tied[0].fit else root
    room = max(root.chi2 - root.freedom, 1e-9)
    patterns = _left(problem, best)
    return SettledAnswer(
        dataset=data.name,
        model=problem.base.name,
        verdict=verdict,
        effects=(tied[0].effect,) if tied else (),
        ranking=tuple(_ranking(problem, root, tried, tied)),
        decisions={c.effect: _decision(problem, c, tied, missing) for c in tried},
        residual_patterns=ResidualPatterns(tuple(patterns), best.chi2),
        explained=verdict != "unknown",
        reasons=why,
        lack_before=None,
        lack_after=None,
        explained_fraction=float(np.clip((root.chi2 - best.chi2) / room, 0.0, 1.0)) if missing else 1.0,
        held_out_error_before=held_out_error(problem, root),
        held_out_error_after=held_out_error(problem, best),
        noise_floor=1.0,
        next_experiment=next_experiment(problem, [c.effect for c in tied], fits_of(tied))
        if len(tied) > 1
        else None,
        notes=tuple(_notes(problem, best, tried, tied)),
        problem=problem,
        root=root,
        tied=tuple(fits_of(tied)),
    )


def _no_effect(problem: SettledProblem, root: SettledFit) -> str:
    return (
        f"{problem.base.name} misses the values (p = {root.p_value:.1g}), and no single effect with plausible"
        " values meets them"
    )


def _ranking(
    problem: SettledProblem, root: SettledFit, tried: list[Candidate], tied: list[Candidate]
) -> list[Ranked]:
    others = [c for c in tried if c.fit is not None and c not in tied]
    others.sort(key=lambda c: (not (c.meets and c.testable), c.fit.objective if c.fit else 0.0, c.effect))
    fits = fits_of(tied)
    apart: list[float | None] = [separation(problem, fits[0], f) for f in fits[1:]]
    apart = [min((a for a in apart if a is not None), default=None), *apart]
    ranked = []
    for place, (c, found) in enumerate(zip((*tied, *others), fits_of([*tied, *others]), strict=True)):
        is_tied = place < len(tied)
        rivals = tuple(r.effect for r in tied if r is not c) if is_tied else ()
        removed = (root.chi2 - found.chi2) / max(root.chi2 - found.freedom, root.chi2 - found.chi2, 1e-9)
        ranked.append(
            Ranked(
                c.effect,
                held_out_error(problem, found) if is_tied else None,
                float(np.clip(removed, 0.0, 1.0)),
                _values(found, c.effect),
                rivals,
                apart[place] if is_tied else None,
                _favour(problem, found, c),
                _against(problem, found, c, rivals, tied),
            )
        )
    return ranked


def _values(found: SettledFit, effect: str) -> tuple[Value, ...]:
    values = []
    for (parameter, at, error), its_pull in zip(*effect_parameters(found, effect), strict=True):
        ends = [
            parameter.value(float(np.clip(at + s * SIGMAS_95 * error, *parameter.bounds))) for s in (-1, 1)
        ]
        plausible = bool(abs(its_pull) <= SIGMAS_95)
        values.append(
            Value(parameter.name, parameter.value(at), min(ends), max(ends), parameter.info.unit, plausible)
        )
    return tuple(values)


def _favour(problem: SettledProblem, found: SettledFit, candidate: Candidate) -> str:
    given = ", ".join(f"{p:.3g}" for p in found.predicted)
    asked = ", ".join(f"{v.value:.3g}" for v in problem.values)
    said = f"gives {given} for {asked} (χ² {found.chi2:.1f})"
    size, plausible, pull = _size(found, candidate.effect)
    return f"{said}; {size} is well within what is plausible {plausible}" if pull <= UNUSUAL else said


def _against(
    problem: SettledProblem,
    found: SettledFit,
    candidate: Candidate,
    rivals: tuple[str, ...],
    tied: list[Candidate],
) -> str:
    parts = []
    size, plausible, pull = _size(found, candidate.effect)
    if pull > UNUSUAL:
        where = "outside" if pull > SIGMAS_95 else "near the edge of"
        parts.append(f"{size} is {where} what is plausible {plausible}")
    if not candidate.testable:
        parts.append("with it there are as many parameters as values: it would fit anything")
    elif not candidate.meets:
        parts.append("the values are not met within their scatter")
    contained = set(problem.library[candidate.effect].limits) & {c.effect for c in tied}
    if contained and candidate.meets:
        parts.append(f"{', '.join(sorted(contained))}, its limit, does as well")
    if rivals:
        parts.append(f"{', '.join(rivals)} cannot be told apart")
    return "; ".join(parts)


def _size(found: SettledFit, effect: str) -> tuple[str, str, float]:
    """An effect's least plausible parameter, its plausible range, and how far it lies to its edge (σ)."""
    sizes, pulls = effect_parameters(found, effect)
    worst = int(np.argmax(np.abs(pulls)))
    parameter, at, _ = sizes[worst]
    unit = "" if parameter.info.unit == "1" else f" {parameter.info.unit}"
    low, high = parameter.info.literature
    pull = abs(float(pulls[worst]))
    size = f"{parameter.name} = {parameter.value(at):.3g}{unit}"
    return size, f"({low:g} to {high:g}; {spelt_sigmas(pull)})", pull


def _decision(
    problem: SettledProblem, candidate: Candidate, tied: list[Candidate], missing: bool
) -> Decision:
    """Present when nothing ties with it, absent only in a model that needs nothing; otherwise not known."""
    parameters = [a for a in problem.parameters((candidate.effect,)) if not a.info.shapes]
    if candidate.fit is None:
        unlimited = decision_at(candidate.effect, parameters[0], np.inf, "cannot_tell", 0.0)
        return dataclasses.replace(unlimited, limit=None)
    sizes = [s for s in effect_parameters(candidate.fit, candidate.effect)[0] if not s[0].info.shapes]
    parameter, at, error = max(
        sizes, key=lambda s: (abs(s[1]) + POLICY.evidence.limit_sigmas * s[2]) / max(s[0].smallest, 1e-9)
    )
    below = all(abs(x) + POLICY.evidence.limit_sigmas * e < a.smallest for a, x, e in sizes)
    word = "present" if tied == [candidate] else "absent" if below and not missing else "cannot_tell"
    return decision_at(candidate.effect, parameter, abs(at) + POLICY.evidence.limit_sigmas * error, word, at)


def _left(problem: SettledProblem, found: SettledFit) -> list[Pattern]:
    patterns = []
    for value, given in zip(problem.values, found.predicted, strict=True):
        assert value.standard_error is not None
        sigmas = (value.value - float(given)) / value.standard_error
        if abs(sigmas) > MISSED:
            law = f"is {value.value:g} where the model gives {given:.3g}"
            size = abs(value.value - float(given))
            share = sigmas**2 / found.chi2
            patterns.append(Pattern(problem.data.words(value.of), law, sigmas, size, value.of.unit, share))
    return sorted(patterns, key=lambda p: -abs(p.sigmas))


def _notes(
    problem: SettledProblem, best: SettledFit, tried: list[Candidate], tied: list[Candidate]
) -> list[str]:
    data = problem.data
    notes = []
    if len(tied) > 1:
        alike = ", ".join(c.effect for c in tied)
        notes.append(f"{alike} meet the values alike; they stand in the order of how plausible they are.")
    runs = problem.run(problem.model(best.parameters, best.x))
    last = f"with {best.effects[-1]} the model" if best.effects else "the model"
    for value in data.values:
        if value.standard_error is None:
            notes.append(
                f"{data.words(value.of)}: {value.value:g} {value.of.unit}, {last} gives"
                f" {problem.reading(runs, value.of):.3g}; no standard error is stated, so it is not weighed."
            )
    if data.zeroed_at_rest:
        notes.append(
            "Readings count from the rest before the first motion (zeroed_at_rest): a constant offset of"
            " a sensor cannot show."
        )
    silent = [c.effect for c in tried if c.fit is None]
    if silent:
        notes.append(f"These change none of the values: {', '.join(silent)}.")
    return notes
