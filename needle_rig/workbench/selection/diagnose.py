"""Which effect is missing: a verdict with its evidence, its rivals and what it cannot tell."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from needle_rig.dataset import Dataset
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.baseline import (
    Baseline,
    as_baseline,
    deviance,
    fit_baseline,
    starts_are_unknown,
    with_starts_of,
)
from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.observations.snaps import snaps
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.answer import Answer, Say
from needle_rig.workbench.selection.decisions import decide
from needle_rig.workbench.selection.design import best_experiment
from needle_rig.workbench.selection.evidence import improves_cross_validation
from needle_rig.workbench.selection.explanation import Explanation, channel_names, explanation
from needle_rig.workbench.selection.lack_of_fit import lack_of_fit
from needle_rig.workbench.selection.notes import (
    constrained_means,
    contrived,
    negligible,
    not_refitted,
    partial,
)
from needle_rig.workbench.selection.odd_trial import odd_trial, without
from needle_rig.workbench.selection.own_starts import with_own_starts
from needle_rig.workbench.selection.ranking import order, rank
from needle_rig.workbench.selection.residual_patterns import find_residual_patterns
from needle_rig.workbench.selection.rivals import Rival, find_rivals
from needle_rig.workbench.selection.search import EffectSet, SearchTrace, search
from needle_rig.workbench.selection.shown_noise import renewed
from needle_rig.workbench.selection.verdict import Findings, above_noise, reasons
from needle_rig.workbench.selection.verdict import verdict as judge

QUICK = (
    "quick: one effect was looked for, each by itself, and fitted where a straight line promises more than"
    " chance; whether a second is missing, and what else could stand beside it, was not asked. Without"
    " quick it is."
)
MOST_TURNS = 6
"""Searches, each under the noise that shows beside what the last one found. Two are enough, as a rule."""


@dataclass(frozen=True)
class Diagnosis(Answer):
    """The answer on traces, with the fits behind it."""

    baseline: Baseline = field(repr=False)
    search: SearchTrace = field(repr=False)
    concluded: tuple[Problem, Fit, CrossValidation] = field(repr=False)
    """The fit of what is named, as a baseline of its own model (`as_baseline`)."""

    @property
    def noise(self) -> dict[str, float]:
        """Standard deviation of a reading, by channel, in the unit that its name ends in."""
        noise = self.baseline.problem.noise
        factors = (nmm(1.0), *(deg(1.0) for _ in self.baseline.dataset.sensor_names))
        names = channel_names(self.baseline.dataset)
        return {
            name: factor * float(s)
            for name, factor, s in zip(names, factors, noise.within_trial, strict=True)
        }

    def explanations(self) -> tuple[Explanation, ...]:
        """What can be adopted: the named effects, then each tie in their place; none without an effect.

        Raises SolverError.
        """
        if self.verdict != "effect":
            return ()
        best = self.search.best
        named = self.ranking[: len(self.effects)]
        ties = [best - {row.effect} | {r} for row in named for r in row.indistinguishable_from]
        first = explanation(self.baseline, *self.concluded, improves=self._improves(best))
        return (first, *(self._in_its_place(key) for key in dict.fromkeys(ties)))

    def _improves(self, key: EffectSet) -> bool:
        return improves_cross_validation(self.search.root_validation, self.search.fits[key][1])

    def _in_its_place(self, key: EffectSet) -> Explanation:
        compared = as_baseline(self.baseline, self.search.problem, *self.search.fits[key])
        return explanation(self.baseline, *compared, improves=self._improves(key))


def diagnose(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None = None,
    *,
    max_effects: int = 3,
    quick: bool = False,
    work: Work | None = None,
    say: Say = lambda _: None,
) -> Diagnosis:
    """Hold the current model against a dataset and look for what is missing; `quick`: for one effect alone.

    Raises BadInput when the dataset cannot be used, SolverError when the current model cannot be solved.
    """
    with work or Work() as at:
        how = _How(library, model, 1 if quick else max_effects, quick, at, say)
        found = concluded(*_competed(how, dataset), work=at, say=say)
        odd = odd_trial(*found.concluded[:2]) if found.verdict == "unknown" else None
        if odd is not None and odd.repeated:
            say(f"trying every effect again, without {odd.file}")
            anew = concluded(*_competed(how, without(dataset, odd)), work=at, say=say)
            if anew.verdict != "unknown" and len(anew.effects) <= POLICY.verdict.at_any_value:
                found = dataclasses.replace(anew, notes=(odd.sentence(left_out=True), *anew.notes))
                odd = None
        if odd is not None:
            found = dataclasses.replace(found, notes=(odd.sentence(left_out=False), *found.notes))
    return dataclasses.replace(found, notes=(QUICK, *found.notes)) if quick else found


def best_effect(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None = None,
    *,
    work: Work,
    say: Say = lambda _: None,
) -> tuple[Baseline, SearchTrace]:
    """The search that a quick diagnosis concludes from: at the best effect alone, or at the current model.

    Raises BadInput, SolverError as `diagnose`.
    """
    return _competed(_How(library, model, 1, True, work, say), dataset)


def concluded(of: Baseline, trace: SearchTrace, *, work: Work, say: Say = lambda _: None) -> Diagnosis:
    """The diagnosis at which a search ends: its rivals and what it leaves are looked at."""
    say("looking for what cannot be told apart")
    work.share(trace.problem)
    apart, rivals = find_rivals(trace, work)
    say("testing the answer against the discretisation error")
    return _conclude(of, apart, rivals, of.dataset.sensor_names)


@dataclass(frozen=True)
class _How:
    """What a dataset is held against, and how far the search goes."""

    library: Mapping[str, type[Effect]]
    model: NeedleModel | None
    max_effects: int
    quick: bool
    work: Work
    say: Say


def _competed(how: _How, given: Dataset) -> tuple[Baseline, SearchTrace]:
    """The effects that compete for a dataset as recorded; anew from the initial twists of another effect
    where what was found misses something."""
    of = with_starts_of(fit_baseline(given, how.model, how.library, say=how.say), given)
    names = of.problem.candidates(of.current.effects)
    how.say("trying every effect")
    of, trace = _in_turns(how, of, given, names, None)
    found, _ = trace.fits[trace.best]
    if not starts_are_unknown(of) or excess(trace.problem, found.objective) <= 0.0:
        return of, trace
    how.say("trying every effect with initial twists of its own")
    own = with_own_starts(of, given, names, deviance(trace.problem, found), how.work)
    return (of, trace) if own is None else _in_turns(how, own[0], given, names, own[1])


def _in_turns(
    how: _How, of: Baseline, given: Dataset, names: tuple[str, ...], begin: Fit | None
) -> tuple[Baseline, SearchTrace]:
    """Effects, then the noise and the initial twists beside them, in turn until none changes.

    Where initial twists are unknown, each turn adds one effect: under those of a model that lacks something,
    a second one would stand for them.
    """
    most = 1 if starts_are_unknown(of) else how.max_effects
    for turn in range(MOST_TURNS):
        trace = search(
            *(of.problem, names, of.current, of.validation),
            max_effects=most,
            work=how.work,
            quick=how.quick,
            begin=begin,
        )
        other = renewed(of, given, trace) if turn + 1 < MOST_TURNS else None
        if other is None and (most == how.max_effects or len(trace.named(trace.best)) < most):
            break
        if other is not None:
            of, told = other
            how.say(told)
        most = min(most + 1, how.max_effects)
        best, _ = trace.fits[trace.best]
        begin = fit(of.problem, best.effects, best.vector)
    return of, trace


def _conclude(
    baseline: Baseline,
    search: SearchTrace,
    rivals: dict[str, list[Rival]],
    sensors: tuple[str, ...],
) -> Diagnosis:
    root, root_validation = search.root, search.root_validation
    named = search.named(search.best)
    not_named = contrived(search, named, bool(baseline.assumed_noise))
    gain = max(0.0, root.objective - search.fits[search.best][0].objective)
    problem, best, validation = search.problem, root, root_validation
    if named and not not_named:
        problem, best, validation = as_baseline(baseline, problem, *search.fits[search.best])
    if not_named:
        named, problem, best, validation = [], search.problem, root, root_validation
    left = find_residual_patterns(problem, best, sensors)
    explained_fraction = gain / (gain + left.gain) if gain + left.gain > 0 else 1.0
    if not named:
        explained_fraction = 1.0 if not left.significant else 0.0
    lack = lack_of_fit(problem, best, sensors)
    seen = snaps(baseline.dataset)
    scale = baseline.dataset.torque_scale
    fitted_error = math.sqrt(best.chi2 / problem.size)
    why = reasons(Findings(tuple(named), left, validation.error, seen, scale, fitted_error))
    verdict = judge(named, why)
    ordered = order(search, named)
    ranking = rank(search, ordered, rivals, verdict, best, validation)
    ties = [(e, r) for e in ordered for r in rivals.get(e, []) if r.tied]
    experiment = None
    if ties and verdict == "effect":
        effect, rival = ties[0]
        mine, other = search.fits[search.best][0], search.fits[rival.key][0]
        experiment = best_experiment(search.problem, mine, other, effect, rival.effect, sensors)
    return Diagnosis(
        dataset=baseline.dataset.name,
        model=problem.base.name,
        verdict=verdict,
        effects=tuple(ordered) if verdict == "effect" else (),
        ranking=tuple(ranking),
        decisions=decide(search, named if verdict == "effect" else [], validation.error),
        residual_patterns=left,
        explained=not why,
        reasons=why,
        lack_before=lack_of_fit(baseline.problem, baseline.current, sensors),
        lack_after=lack,
        explained_fraction=explained_fraction,
        held_out_error_before=root_validation.error,
        held_out_error_after=validation.error if verdict == "effect" else root_validation.error,
        noise_floor=1.0,
        next_experiment=experiment,
        notes=(
            *baseline.dataset.notes,
            *baseline.notes,
            *baseline.assumed_noise,
            *(() if above_noise(validation.error) else negligible(search)),
            *constrained_means(best),
            *(not_refitted(search, named) if verdict == "effect" else []),
            *(partial(named, explained_fraction, validation) if verdict == "unknown" and named else []),
            *not_named,
        ),
        baseline=baseline,
        search=search,
        concluded=(problem, best, validation),
    )
