"""What law is missing that no library holds: a verdict, with its curve, its formula and its effect file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.estimation.baseline import Baseline
from needle_rig.workbench.estimation.parameters import FreeParameter
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.laws.curve import fitted_curve
from needle_rig.workbench.laws.draft import Origin, Table, formula_text
from needle_rig.workbench.laws.fitting import NOT_HELD_OUT
from needle_rig.workbench.laws.formulas import Formula
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.law_search import FoundLaw, LawCandidates, tied, without_law
from needle_rig.workbench.laws.learnt import Learnt, LearntLaw, Verdict
from needle_rig.workbench.laws.made import FormulaLaw
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.answer import Say
from needle_rig.workbench.selection.design import best_experiment
from needle_rig.workbench.selection.diagnose import Diagnosis, best_effect, concluded, diagnose
from needle_rig.workbench.selection.documents import NextTrial
from needle_rig.workbench.selection.evidence import asked_of
from needle_rig.workbench.selection.search import EffectSet, SearchTrace, back, expand


def learn_laws(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None = None,
    *,
    origin: Origin,
    work: Work | None = None,
    say: Say = lambda _: None,
) -> Learnt:
    """Hold the library against a dataset, then laws that it does not hold.

    Raises BadInput when the dataset cannot be used, SolverError when the present model cannot be solved.
    """
    with work or Work() as at:
        begun = best_effect(dataset, library, model, work=at, say=say)
        with LawCandidates(at, origin) as laws:
            learnt = _Learning(*begun, laws, at, say).answer()
        if learnt.verdict != "cannot_tell":
            return learnt
        told = learnt if learnt.laws else answered_by(concluded(*begun, work=at, say=say), learnt)
        if told is learnt:
            say("no law was found: diagnosing with the library alone")
            told = answered_by(diagnose(dataset, library, model, work=at, say=say), learnt)
        return told


def goes_on(steps: int, reached: bool) -> bool:
    """Whether one more law, or a library effect beside it, is looked for."""
    return not reached and steps < POLICY.verdict.at_any_value


def reaches(error: float, commands: int) -> bool:
    """Whether commands left out are predicted to within the noise; one command alone leaves none out.

    The error is infinite where a model cannot be solved with a command left out: that is none.
    """
    return commands <= 1 or error <= POLICY.laws.reached


def verdict_of(reached: bool, tied_with: int) -> Verdict:
    """Of laws that were found, whether these reach the noise and how many tie with one of them at most."""
    return "law" if reached and tied_with <= POLICY.laws.ties else "cannot_tell"


@dataclass(frozen=True, eq=False)
class Term:
    """A law in the model."""

    found: FoundLaw
    ties: tuple[FoundLaw, ...]
    held_out_before: float
    """Error on commands left out of what it was first added to, in units of the noise."""


class _Learning:
    """The search gone on with laws: these and effects of the library are added, swapped and dropped."""

    def __init__(
        self, baseline: Baseline, trace: SearchTrace, laws: LawCandidates, work: Work, say: Say
    ) -> None:
        self.baseline, self.begun, self.laws, self.work, self.say = baseline, trace, laws, work, say
        self.terms: dict[str, Term] = {}

    def answer(self) -> Learnt:
        """What the model lacks, one after the other; each is looked for anew beside what was found later."""
        trace = self.begun
        begin = at = trace if reached(trace) else dataclasses.replace(trace, best=trace.start)
        self.work.share(at.problem)
        steps = 0
        while goes_on(steps, steps > 0 and reached(at)):
            more = self._added(at)
            if more.best == at.best or (not laws_in(more) and at is not begin):
                at = dataclasses.replace(more, best=at.best)
                break
            at = back(self._swapped(at.best, more), self.work)
            steps += bool(laws_in(at))
        return self._told(at)

    def _added(self, trace: SearchTrace) -> SearchTrace:
        """With the law that does best on top, or the effect of the library; as it was where neither is worth
        its name."""
        self.say("screening laws that the library does not hold")
        parent = trace.fits[trace.best][0]
        promised = self.laws.screened(trace.problem, parent, self._taken(trace))
        trace = dataclasses.replace(trace, laws_tried=max(trace.laws_tried, len(promised)))
        if not laws_in(trace) and (not promised or promised[0].gain <= asked_of(len(promised))):
            return trace
        self.say("fitting the leading laws")
        found = self.laws.on_top_of(trace.problem, parent, promised)
        law = trace.best
        if found:
            trace, law = self._with_law(trace, found, trace.validation(trace.best).error)
        self.say("trying the library")
        trace = expand(trace, self.work, trace.best, trace.score(trace.best) - trace.score(law))
        rival = best_of_library(trace, trace.best)
        if law != trace.best and trace.passes(trace.best, law) and (rival is None or trace.beats(rival, law)):
            return dataclasses.replace(trace, best=law).stepped("forward")
        return trace if rival is None else dataclasses.replace(trace, best=rival).stepped("forward")

    def _taken(self, trace: SearchTrace) -> set[Law]:
        return {self.terms[name].found.law for name in laws_in(trace)}

    def _with_law(
        self, trace: SearchTrace, found: Sequence[FoundLaw], before: float
    ) -> tuple[SearchTrace, EffectSet]:
        """The search with the first of the laws that were found fitted, and its set of effects."""
        best = found[0].best
        self.terms[best.made.name] = Term(found[0], tied(found[0].law, found[0].score, found[1:]), before)
        problem = trace.problem.with_effects(best.made.effect())
        self.work.share(problem)
        trace = dataclasses.replace(trace, problem=problem, laws={**trace.laws, best.made.name: best.price})
        return trace.keep(best.fit, best.validation), frozenset(best.fit.effects)

    def _swapped(self, before: EffectSet, trace: SearchTrace) -> SearchTrace:
        """With each law looked for anew beside what was found after it, and the library in its place.

        Its place and its formula were chosen when that was still missing.
        """
        changed = False
        for name in laws_in(trace):
            parent = without_law(trace.problem, trace.fits[trace.best][0], name)
            if parent is None:
                continue
            rest = trace.best - {name}
            known = rest in trace.fits
            scratch = trace if known else trace.keep(parent, NOT_HELD_OUT)
            library = self._library_in_place(scratch, rest)
            if library is not None:
                kept = {k: v for k, v in library.fits.items() if known or k != rest}
                trace, changed = dataclasses.replace(library, fits=kept), True
            elif name in before or changed:
                self.say("looking again for a law beside what was found after it")
                was = trace.best
                trace = self._looked_for_again(trace, name, parent)
                changed |= trace.best != was
        return trace

    def _looked_for_again(self, trace: SearchTrace, name: str, parent: Fit) -> SearchTrace:
        """With the best law in the place of the one of this name; where that stays, its spline and ties are
        those found now."""
        old, at = self.terms[name], trace.score(trace.best)
        taken = self._taken(trace) - {old.found.law}
        promised = self.laws.screened(trace.problem, parent, taken)
        found = self.laws.on_top_of(trace.problem, parent, promised)
        if found:
            more, key = self._with_law(trace, found, old.held_out_before)
            if more.score(key) < at:
                return dataclasses.replace(more, best=key).stepped("swapped")
        stays, law = old.found, old.found.law
        same = [each for each in found if each.law == law]
        if same and stays.formula is not None:
            stays = dataclasses.replace(stays, spline=same[0].spline)
        others = [each for each in found if each.law != law]
        alone = at - sum(trace.laws[each] for each in laws_in(trace) if each != name)
        self.terms[name] = Term(stays, tied(law, alone, others), old.held_out_before)
        return trace

    def _library_in_place(self, trace: SearchTrace, rest: EffectSet) -> SearchTrace | None:
        """The search with effects of the library in the place of a law that they do as well as; None: they do
        not."""
        at, key = trace.score(trace.best), rest
        for _ in range(POLICY.verdict.at_any_value):
            self.say("trying the library")
            trace = expand(trace, self.work, key, trace.score(key) - at)
            more = best_of_library(trace, key)
            if more is None:
                return None
            key = more
            if trace.score(key) < at + asked_of(trace.laws_tried):
                return dataclasses.replace(trace, best=key).stepped("swapped")
        return None

    def _told(self, trace: SearchTrace) -> Learnt:
        names = laws_in(trace)
        if not names:
            sentence = (
                "Something is missing that is neither an effect of the library nor one of the"
                f" {trace.laws_tried} laws that were tried."
            )
            return self._answer(trace, "cannot_tell", (), (), trace.root_validation.error, sentence)
        current, error = trace.fits[trace.best][0], trace.validation(trace.best).error
        ties_most = max(len(self.terms[name].ties) for name in names)
        verdict = verdict_of(reached(trace), ties_most)
        *earlier, last = (self._law(trace.problem, current, self.terms[name]) for name in names)
        # what was found or looked for anew after it has lowered the error, too
        laws = (*earlier, dataclasses.replace(last, held_out_after=error))
        words = " and ".join(law.law.words() for law in laws)
        if verdict == "law":
            sentence = words[0].upper() + words[1:] + "."
        elif not reached(trace):
            left = f"leaves {error:.2f} × the noise on" if math.isfinite(error) else "cannot be solved with"
            sentence = (
                f"A law is missing, and these data do not say which: the nearest ({words}) {left} commands"
                " left out."
            )
        else:
            sentence = (
                "A law is missing, and these data do not say which:"
                f" {ties_most + 1} of those that were tried do alike; the nearest: {words}."
            )
        library = tuple(e for e in current.effects if e not in names and e not in trace.start)
        return self._answer(trace, verdict, laws, library, error, sentence)

    def _answer(
        self,
        trace: SearchTrace,
        verdict: Verdict,
        laws: tuple[LearntLaw, ...],
        library: tuple[str, ...],
        after: float,
        sentence: str,
    ) -> Learnt:
        before, origin = self.begun.root_validation.error, self.laws.origin
        return Learnt(
            verdict, laws, library, before, after, sentence, trace.laws_tried, self.baseline, origin
        )

    def _law(self, problem: Problem, current: Fit, term: Term) -> LearntLaw:
        found, ties = term.found, term.ties
        formula, parameters = _fitted_formula(current, found)
        curve = fitted_curve(problem, current, found, formula)
        told = formula or Table(curve.at, curve.value)
        text = (
            None
            if formula is None
            else f"{formula.form.name}: {formula_text(formula)}{_kind(found.law, parameters)}"
        )
        return LearntLaw(
            found.law,
            tuple(each.law for each in ties),
            term.held_out_before,
            found.best.validation.error,
            text,
            parameters,
            curve,
            told,
            self._experiment(problem, found, ties),
        )

    def _experiment(self, problem: Problem, found: FoundLaw, ties: Sequence[FoundLaw]) -> NextTrial | None:
        """The trial that would tell the law from the first that ties with it."""
        if not ties:
            return None
        self.say("looking for the experiment that would tell")
        other = ties[0]
        problem = problem.with_effects(found.best.made.effect(), other.best.made.effect())
        first, second = found.best.fit, other.best.fit
        sensors = self.baseline.dataset.sensor_names
        return best_experiment(problem, first, second, found.law.name, other.law.name, sensors)


def answered_by(diagnosis: Diagnosis, learnt: Learnt) -> Learnt:
    """The answer that a diagnosis gives where no law was found: nothing is missing, or the library holds it;
    `learnt` itself where it gives none."""
    if diagnosis.verdict == "unknown":
        return learnt
    if diagnosis.verdict == "none":
        small = ", ".join(sorted(diagnosis.search.negligible))
        seen = f" ({small} of the library: too small to matter)" if small else ""
        sentence = f"Nothing is missing that these data show{seen}; {learnt.tried} laws were tried."
    else:
        named = " with ".join(diagnosis.effects)
        sentence = f"The library holds it: {named}; {learnt.tried} laws were tried beside it."
    return dataclasses.replace(
        learnt,
        verdict="none" if diagnosis.verdict == "none" else "library",
        laws=(),
        library=diagnosis.effects,
        # both in the noise of this diagnosis, which may have been measured anew
        held_out_before=diagnosis.held_out_error_before,
        held_out_after=diagnosis.held_out_error_after,
        sentence=sentence,
        baseline=diagnosis.baseline,
    )


def laws_in(trace: SearchTrace) -> list[str]:
    """The laws of the best set, in the order in which they were added."""
    return [effect for effect in trace.fits[trace.best][0].effects if effect in trace.laws]


def best_of_library(trace: SearchTrace, key: EffectSet) -> EffectSet | None:
    """The best of the sets with one effect of the library more that pass; None where none does."""
    more = [key | {each.effect} for each in trace.children[key]]
    return min(
        (k for k in more if k in trace.fits and trace.passes(key, k)), key=trace.by_score, default=None
    )


def reached(trace: SearchTrace) -> bool:
    """Whether the best set predicts commands left out to within the noise."""
    return reaches(trace.validation(trace.best).error, len(trace.problem.groups))


def _fitted_formula(
    current: Fit, found: FoundLaw
) -> tuple[Formula | None, tuple[tuple[str, float, float, str], ...]]:
    """The formula with its numbers as all laws were last fitted together, and these with their errors."""
    best = found.best.made
    if not isinstance(best, FormulaLaw):
        return None, ()
    rows = []
    for parameter, at, error in zip(
        current.parameters, current.vector.scaled_values, current.scaled_errors, strict=True
    ):
        if parameter.effect == best.name:
            spread = _spread(parameter, float(at), float(error))
            rows.append((parameter.field, parameter.value(float(at)), spread, parameter.info.unit))
    return best.formula_at(current), tuple(rows)


def _kind(law: Law, parameters: Sequence[tuple[str, float, float, str]]) -> str:
    """What a formula alone does not say."""
    play = "".join(f" in a play of {value:.3g}°" for field, value, _, _ in parameters if field == "play_deg")
    return {
        "plain": "",
        "gain": ", times the reading",
        "play": f", v how far the reading's angle is ahead{play}",
        "forward": ", v turned forward alone",
        "backward": ", v turned backward alone",
    }[law.kind]


def _spread(parameter: FreeParameter, at: float, error: float) -> float:
    low, high = (parameter.value(float(np.clip(at + s * error, *parameter.bounds))) for s in (-1, 1))
    return abs(high - low) / 2
