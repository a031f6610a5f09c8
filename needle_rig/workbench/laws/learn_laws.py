"""What law is missing that no library holds: a verdict, with its curve, its formula and its effect file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

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
from needle_rig.workbench.laws.made import FormulaLaw, Shared
from needle_rig.workbench.laws.screening import Screened
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.candidates import Candidate, fitted, score, screened
from needle_rig.workbench.selection.design import best_experiment
from needle_rig.workbench.selection.diagnose import Diagnosis, diagnose
from needle_rig.workbench.selection.documents import NextTrial
from needle_rig.workbench.selection.search import SearchTrace, expand, promise_asked


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


class _Learning:
    """One run: what is known as it goes on."""

    def __init__(
        self, diagnosis: Diagnosis, search: LawSearch, sensors: Sequence[str], origin: Origin
    ) -> None:
        self.diagnosis, self.search, self.sensors, self.origin = diagnosis, search, sensors, origin
        trace = diagnosis.search
        self.root = _parent(trace, trace.start)
        self.library = min((_parent(trace, key) for key in _supported(trace)), key=lambda p: p.score)
        self.found: list[tuple[FoundLaw, tuple[FoundLaw, ...]]] = []
        self.tried = 0

    def _reached(self, found: Parent) -> bool:
        return reaches(found.validation.error, len(self.search.problem.groups))

    def answer(self) -> Learnt:
        """The laws, one after the other."""
        current = self._first()
        steps = 1
        while current is not None and goes_on(steps, self._reached(current)):
            further = self._next(current)
            if further is None:
                break
            current, steps = self._revised(further), steps + 1
        return self._told(current and self._pruned(self._library_in_place(current)))

    def _first(self) -> Parent | None:
        """The fit with the first law; None where there is none."""
        search, root, library = self.search, self.root, self.library
        search.say("screening laws that the library does not hold")
        alone = library.fit is root.fit
        on_root: list[Screened] = []
        on_library: list[Screened] = []
        if self.diagnosis.verdict != "unknown":
            on_library = search.promises(library)
            self.tried = len(on_library)
            if not on_library or on_library[0].gain <= asked_of(self.tried):
                return None
            on_root = on_library if alone else []
        on_root = on_root or search.promises(root)
        self.tried = len(on_root)
        search.say("fitting the leading laws")
        rounds = [search.on_top_of(root, on_root)]
        if not alone and not _better(rounds[0], library):
            search.say("fitting laws beside what the library explains")
            rounds.append(search.on_top_of(library, on_library or search.promises(library)))
        chosen = self._chosen(rounds)
        return self._kept(chosen, self._pair(library, chosen[0])) if chosen else None

    def _pair(self, library: Parent, found: FoundLaw) -> Parent:
        """The library's best with one more effect, where screening promises that it comes near a law."""
        trace, search = self.diagnosis.search, self.search
        key = frozenset(library.fit.effects)
        if key == trace.start:
            return library
        search.say("trying pairs of the library's effects")
        search.work.share(trace.problem)
        trace = expand(trace, search.work, key, library.score - found.score)
        return min((_parent(trace, k) for k in _supported(trace)), key=lambda p: p.score)

    def _next(self, current: Parent) -> Parent | None:
        """The fit with one more law, which must do better than any library effect in its place."""
        search = self.search
        search.say("looking at the residual")
        promised = search.promises(current)
        search.say("fitting the leading laws")
        chosen = self._chosen([search.on_top_of(current, promised)])
        gain = current.score - chosen[0].score if chosen else 0.0
        rival = self._with_library(current, gain)
        kept_law = self._kept(chosen, rival) if chosen else None
        if kept_law is None and rival is not current:
            return self._beside(current, rival)
        return kept_law

    def _revised(self, current: Parent) -> Parent:
        """The fit with each law looked for anew beside what was found after it.

        Its place and its formula were chosen when that was still missing.
        """
        search, changed = self.search, len(self.found) == 1
        for place, (old, _) in enumerate(self.found):
            if place == len(self.found) - 1 and not changed:
                break
            search.say(f"looking again for law {place + 1} beside what was found after it")
            rest = search.without(current, old)
            if rest is None:
                continue
            chosen = search.in_place_of(old, rest)
            if chosen and chosen[0].score < current.score:
                new = dataclasses.replace(chosen[0], parent=old.parent)
                current, changed = search.put(old, new), True
            else:
                same = [each.spline for each in chosen if each.law == old.law and old.formula is not None]
                # its spline and its ties are now fitted beside the others
                made = dict.fromkeys((*old.beside, *(m for each in chosen for m in each.beside)))
                new = dataclasses.replace(old, spline=same[0] if same else old.spline, beside=tuple(made))
            others = [each for each in chosen if each.law != new.law]
            self.found[place] = new, tied((dataclasses.replace(new, at=current.score), *others))
        return current

    def _library_in_place(self, current: Parent) -> Parent:
        """The fit with an effect of the library for each of several laws that it does as well as.

        When that law was kept, another was still missing.
        """
        for old, _ in list(self.found):
            rest = self.search.without(current, old) if len(self.found) > 1 else None
            if rest is None:
                continue
            made = self.search.leave(old)
            rival = self._with_library(rest, rest.score - current.score)
            if rival is not rest and rival.score < current.score + asked_of(self.tried):
                self.found = [each for each in self.found if each[0] is not old]
                current = rival
            else:
                self.search.made = made
        return current

    def _pruned(self, current: Parent) -> Parent:
        """The fit without effects of the library to which the laws have left nothing.

        They were named when a law was still missing that they resemble.
        """
        laws = {each.best.made.name for each, _ in self.found}
        for name in current.fit.effects:
            if name in laws or name in self.diagnosis.search.start:
                continue
            self.search.say(f"looking whether {name} is needed beside the law")
            rest = self.search.without_effect(current, name)
            if rest is None or rest.score > current.score + POLICY.ties.close:
                continue
            if self._reached(rest) or not self._reached(current):
                current = rest
        return current

    def _chosen(self, rounds: Sequence[Sequence[FoundLaw]]) -> Sequence[FoundLaw]:
        """The laws of the best round; an effect of the library beside the law must be worth its name."""
        leading = [found for found in rounds if found]
        if not leading:
            return ()
        best = min(leading, key=lambda found: found[0].score)
        first = leading[0]
        return first if first[0].score < best[0].score + POLICY.ties.close else best

    def _kept(self, chosen: Sequence[FoundLaw], rival: Parent) -> Parent | None:
        best = chosen[0]
        if not kept(self.search.whole_problem(), best.parent, rival, best, self.tried):
            return None
        self.found.append((best, tied(chosen)))
        return self.search.add(best)

    def _with_library(self, current: Parent, gain: float) -> Parent:
        """The best fit of one library effect on top that may gain that much, or the fit."""
        problem, search = self.search.whole_problem(), self.search
        search.say("trying the library beside the law")
        trace = self.diagnosis.search
        names = [n for n in trace.names if n not in current.fit.effects]
        search.work.share(Shared(search.problem, search.made))
        tried: list[Candidate] = search.work.run(
            _try_library, [(current.fit, n, promise_asked(gain)) for n in names]
        )
        known = current.score - score(problem, current.fit)
        fits = [
            Parent(c.fit, c.validation, score(problem, c.fit) + known)
            for c in tried
            if c.fit and c.validation
        ]
        return min([current, *fits], key=lambda p: p.score)

    def _beside(self, current: Parent, rival: Parent) -> Parent | None:
        """The library effect beside the law, if it is worth its name."""
        gained = current.score - rival.score > POLICY.ties.close
        return rival if gained and rival.validation.loss < current.validation.loss else None

    def _told(self, current: Parent | None) -> Learnt:
        diagnosis = self.diagnosis
        before = diagnosis.held_out_error_before
        if current is None or not self.found:
            return self._without_law(before)
        ties_most = max(len(ties) for _, ties in self.found)
        reached = self._reached(current)
        verdict = verdict_of(reached, ties_most)
        *earlier, last = (self._law(current, place) for place in range(len(self.found)))
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
        made = {each.best.made.name for each, _ in self.found}
        library = tuple(e for e in current.fit.effects if e not in made and e not in diagnosis.search.start)
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

    def _law(self, current: Parent, place: int) -> LearntLaw:
        found, ties = self.found[place]
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
            found.parent.validation.error,
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


def _better(met: Sequence[FoundLaw], library: Parent) -> bool:
    """Whether a law alone reaches the noise, and does better than the library."""
    best = met[0].best if met else None
    return best is not None and best.score < library.score and best.validation.error <= POLICY.laws.reached


def _try_library(shared: Shared, parent: Fit, effect: str, worth: float) -> Candidate:
    problem = shared.with_made()
    candidate = screened(problem, parent, effect)
    return fitted(problem, parent, candidate) if candidate.screening.gain >= worth else candidate


def _parent(trace: SearchTrace, key: frozenset[str]) -> Parent:
    found, validation = trace.fits[key]
    return Parent(found, validation or trace.root_validation, present_score(trace.problem, found))


def _supported(trace: SearchTrace) -> list[frozenset[str]]:
    """The sets of library effects that do better than what they start from; that itself among them."""
    return [trace.start, *(k for k in trace.fits if k != trace.start and trace.passes(trace.start, k))]


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
