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
from needle_rig.workbench.estimation.parameters import FreeParameter
from needle_rig.workbench.estimation.problem import Fit
from needle_rig.workbench.laws.curve import fitted_curve
from needle_rig.workbench.laws.draft import Origin, Table, formula_text
from needle_rig.workbench.laws.fitting import Parent, present_score
from needle_rig.workbench.laws.formulas import Formula
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.law_search import (
    FoundLaw,
    LawSearch,
    Say,
    asked_of,
    kept,
    tied,
)
from needle_rig.workbench.laws.learnt import Learnt, LearntLaw, Verdict
from needle_rig.workbench.laws.made import FormulaLaw, Made, Shared
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.candidates import Candidate, fitted, score, screened
from needle_rig.workbench.selection.design import best_experiment
from needle_rig.workbench.selection.diagnose import Diagnosis, diagnose
from needle_rig.workbench.selection.documents import NextTrial
from needle_rig.workbench.selection.search import SearchTrace, promise_asked


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
        diagnosis = diagnose(dataset, library, model, max_effects=1, quick=True, work=at, say=say)
        with LawSearch(diagnosis.search.problem, at, origin, say) as search:
            learning = _Learning(diagnosis, search, dataset.sensor_names, origin)
            learnt = learning.answer()
        if learnt.verdict != "cannot_tell":
            return learnt
        say("no law was found: holding several effects of the library at once against it")
        whole = diagnose(dataset, library, model, work=at, say=say)
        return learning.answered_by(whole) or learnt


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

    @property
    def made(self) -> Made:
        """What stands for it in the fit."""
        return self.found.best.made


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects of the library and laws in one model, fitted together."""

    fitted: Parent
    terms: tuple[Term, ...] = ()


class _Learning:
    """One competition: laws and effects of the library are added, swapped and dropped."""

    def __init__(
        self, diagnosis: Diagnosis, search: LawSearch, sensors: Sequence[str], origin: Origin
    ) -> None:
        self.diagnosis, self.search, self.sensors, self.origin = diagnosis, search, sensors, origin
        self.trace = diagnosis.search
        self.tried = 0

    def _reached(self, found: Parent) -> bool:
        return reaches(found.validation.error, len(self.search.problem.groups))

    def answer(self) -> Learnt:
        """What the model lacks, one after the other; each is looked for anew beside what was found later."""
        begin = at = Hypothesis(self._present())
        steps = 0
        while goes_on(steps, steps > 0 and self._reached(at.fitted)):
            more = self._added(at)
            if more is None or (not more.terms and at is not begin):
                break
            at = self._dropped(self._swapped(at, more))
            steps += bool(at.terms)
        return self._told(at)

    def _present(self) -> Parent:
        """What laws are added to: the present model, or its diagnosis where that leaves nothing."""
        trace = self.trace
        explained = self.diagnosis.verdict == "effect"
        return _parent(trace, trace.best if explained else trace.start)

    def _added(self, at: Hypothesis) -> Hypothesis | None:
        """With the law that does best on top, or the effect of the library; None where neither is worth its
        name."""
        search = self.search
        search.say("screening laws that the library does not hold")
        promised = search.promises(at.fitted)
        self.tried = max(self.tried, len(promised))
        if not at.terms and (not promised or promised[0].gain <= asked_of(len(promised))):
            return None
        search.say("fitting the leading laws")
        found = search.on_top_of(at.fitted, promised)
        gain = at.fitted.score - found[0].score if found else 0.0
        rival = self._with_effect(at.fitted, gain)
        if found and kept(search.problem_of(at.fitted), rival or at.fitted, found[0], len(promised)):
            return self._with_law(at, found, at.fitted.validation.error)
        return None if rival is None else dataclasses.replace(at, fitted=rival)

    def _with_law(self, at: Hypothesis, found: Sequence[FoundLaw], before: float) -> Hypothesis:
        best = found[0]
        term = Term(best, tied(best.law, best.score, found[1:]), before)
        return Hypothesis(best.added, (*at.terms, term))

    def _with_effect(self, at: Parent, gain: float) -> Parent | None:
        """The best fit of one more effect of the library, of those that may come near a `gain`; None where
        none does better on commands left out, too."""
        search, trace = self.search, self.trace
        search.say("trying the library")
        problem = search.problem_of(at)
        names = [n for n in trace.names if n not in at.fit.effects]
        ahead: list[Candidate] = search.run(at, _screened, [(at.fit, name) for name in names])
        asked = promise_asked(max([gain, *(each.screening.gain for each in ahead)]))
        near = [each for each in ahead if each.screening.gain >= asked]
        tried: list[Candidate] = search.run(at, _fitted, [(at.fit, each) for each in near])
        known = at.score - score(problem, at.fit)
        best = min(
            (
                Parent(each.fit, each.validation, score(problem, each.fit) + known, at.made)
                for each in tried
                if each.fit and each.validation
            ),
            key=lambda found: found.score,
            default=at,
        )
        worth = at.score - best.score > POLICY.ties.close
        return best if worth and best.validation.loss < at.validation.loss else None

    def _swapped(self, before: Hypothesis, at: Hypothesis) -> Hypothesis:
        """With each law looked for anew beside what was found after it, and the library in its place.

        Its place and its formula were chosen when that was still missing.
        """
        search, changed = self.search, False
        for old in at.terms:
            rest = search.without_law(at.fitted, old.made, old.found.best.price)
            if rest is None:
                continue
            library = self._library_in_place(rest, at.fitted)
            if library is not None:
                at, changed = Hypothesis(library, tuple(each for each in at.terms if each is not old)), True
            elif old in before.terms or changed:
                search.say("looking again for a law beside what was found after it")
                was = at.fitted
                at = self._looked_for_again(at, old, search.on_top_of(rest, search.promises(rest)))
                changed |= at.fitted is not was
        return at

    def _looked_for_again(self, at: Hypothesis, old: Term, found: Sequence[FoundLaw]) -> Hypothesis:
        """With the best law in the place of `old`; where that stays, its spline and ties are those found
        now."""
        if found and found[0].score < at.fitted.score:
            best = found[0]
            new = Term(best, tied(best.law, best.score, found[1:]), old.held_out_before)
            fitted = best.added
        else:
            law, kept_law = old.found.law, old.found
            same = [each for each in found if each.law == law]
            if same and kept_law.formula is not None:
                beside = tuple(dict.fromkeys((*kept_law.beside, *same[0].beside)))
                kept_law = dataclasses.replace(kept_law, spline=same[0].spline, beside=beside)
            others = [each for each in found if each.law != law]
            new = Term(kept_law, tied(law, at.fitted.score, others), old.held_out_before)
            fitted = at.fitted
        return Hypothesis(fitted, tuple(new if each is old else each for each in at.terms))

    def _library_in_place(self, rest: Parent, at: Parent) -> Parent | None:
        """A fit with effects of the library in the place of a law that they do as well as; None: they do
        not."""
        found = rest
        for _ in range(POLICY.verdict.at_any_value):
            more = self._with_effect(found, found.score - at.score)
            if more is None:
                return None
            if more.score < at.score + asked_of(self.tried):
                return more
            found = more
        return None

    def _dropped(self, at: Hypothesis) -> Hypothesis:
        """Without effects of the library to which the laws have left nothing.

        They were named when a law was still missing that they resemble.
        """
        laws = {each.made.name for each in at.terms}
        for name in at.fitted.fit.effects:
            if not laws or name in laws or name in self.trace.start:
                continue
            self.search.say(f"looking whether {name} is needed beside the law")
            rest = self.search.without_effect(at.fitted, name)
            if rest is None or rest.score > at.fitted.score + POLICY.ties.close:
                continue
            if self._reached(rest) or not self._reached(at.fitted):
                at = dataclasses.replace(at, fitted=rest)
        return at

    def _told(self, at: Hypothesis) -> Learnt:
        current = at.fitted
        if not at.terms:
            return self._without_law(self.diagnosis.held_out_error_before)
        ties_most = max(len(term.ties) for term in at.terms)
        reached = self._reached(current)
        verdict = verdict_of(reached, ties_most)
        *earlier, last = (self._law(current, term) for term in at.terms)
        # what was found or looked for anew after it has lowered the error, too
        laws = (*earlier, dataclasses.replace(last, held_out_after=current.validation.error))
        words = " and ".join(law.law.words() for law in laws)
        if verdict == "law":
            sentence = words[0].upper() + words[1:] + "."
        elif not reached:
            error = current.validation.error
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
        made = {term.made.name for term in at.terms}
        library = tuple(e for e in current.fit.effects if e not in made and e not in self.trace.start)
        return self._answer(verdict, laws, library, current.validation.error, sentence)

    def _without_law(self, before: float) -> Learnt:
        sentence = (
            "Something is missing that is neither an effect of the library nor one of the"
            f" {self.tried} laws that were tried."
        )
        return self.answered_by(self.diagnosis) or self._answer("cannot_tell", (), (), before, sentence)

    def answered_by(self, diagnosis: Diagnosis) -> Learnt | None:
        """The answer without a law that a diagnosis gives: nothing is missing, or the library holds it."""
        if diagnosis.verdict == "unknown":
            return None
        if diagnosis.verdict == "none":
            small = ", ".join(sorted(diagnosis.search.negligible))
            seen = f" ({small} of the library: too small to matter)" if small else ""
            sentence = f"Nothing is missing that these data show{seen}; {self.tried} laws were tried."
        else:
            named = " with ".join(diagnosis.effects)
            sentence = f"The library holds it: {named}; {self.tried} laws were tried beside it."
        # both errors in the noise of this diagnosis, which may have been measured anew
        before, after = diagnosis.held_out_error_before, diagnosis.held_out_error_after
        verdict: Verdict = "none" if diagnosis.verdict == "none" else "library"
        return Learnt(
            verdict, (), diagnosis.effects, before, after, sentence, self.tried, diagnosis, self.origin
        )

    def _answer(
        self,
        verdict: Verdict,
        laws: tuple[LearntLaw, ...],
        library: tuple[str, ...],
        after: float,
        sentence: str,
    ) -> Learnt:
        before = self.diagnosis.held_out_error_before
        diagnosis, origin = self.diagnosis, self.origin
        return Learnt(verdict, laws, library, before, after, sentence, self.tried, diagnosis, origin)

    def _law(self, current: Parent, term: Term) -> LearntLaw:
        found, ties = term.found, term.ties
        formula, parameters = _fitted_formula(current.fit, found)
        curve = fitted_curve(self.search.problem, current.fit, found, formula)
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
            self._experiment(found, ties),
        )

    def _experiment(self, found: FoundLaw, ties: Sequence[FoundLaw]) -> NextTrial | None:
        """The trial that would tell the law from the first that ties with it."""
        if not ties:
            return None
        self.search.say("looking for the experiment that would tell")
        other = ties[0]
        problem = Shared(self.search.problem, found.beside).with_made(found.best.made, other.best.made)
        first, second = found.best.fit, other.best.fit
        return best_experiment(problem, first, second, found.law.name, other.law.name, self.sensors)


def _screened(shared: Shared, parent: Fit, effect: str) -> Candidate:
    return screened(shared.with_made(), parent, effect)


def _fitted(shared: Shared, parent: Fit, candidate: Candidate) -> Candidate:
    return fitted(shared.with_made(), parent, candidate)


def _parent(trace: SearchTrace, key: frozenset[str]) -> Parent:
    found, validation = trace.fits[key]
    return Parent(found, validation or trace.root_validation, present_score(trace.problem, found))


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
