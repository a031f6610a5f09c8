"""The search for laws: one after the other on top of what the library explains, each judged as an effect.

Every law is screened; the leading ones are fitted inside the solver, a few steps at a time; those that stay
close get formulas, which are fitted in the spline's place. A law is kept when it does better than every
library effect and than chance, also on commands left out, and cannot be our own error.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.numerics import Array
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.cross_validation import cross_validate
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem
from needle_rig.workbench.laws.draft import Origin, written
from needle_rig.workbench.laws.fitting import (
    NOT_HELD_OUT,
    LawFit,
    Parent,
    first_fit,
    fit_formula,
    from_formula,
    from_task,
    further_fit,
    held_out,
)
from needle_rig.workbench.laws.formulas import Formula, ranked
from needle_rig.workbench.laws.law import UNIT, Law
from needle_rig.workbench.laws.made import FormulaLaw, Made, Shared
from needle_rig.workbench.laws.screening import Screened, candidates, screen, seen
from needle_rig.workbench.laws.spline_effect import SplineLaw
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.candidates import penalty
from needle_rig.workbench.selection.evidence import improves_cross_validation, within_discretisation_error

Say = Callable[[str], None]

FIRST_FITS = 10
"""Laws that are fitted for a few steps,"""
FURTHER_FITS = 6
"""for some more,"""
WHOLE_FITS = 4
"""to the end,"""
WITH_FORMULA = 3
"""and with formulas,"""
FORMULAS = 4
"""of which so many forms are fitted inside the solver."""
BEHIND = 100.0
"""Score behind the best (10σ), above what that misses of the noise, from which a law is left."""


@dataclass(frozen=True)
class FoundLaw:
    """A law with its best spline and, where the data bear one, its formula."""

    spline: LawFit
    formula: LawFit | None
    parent: Parent
    beside: tuple[Made, ...] = ()
    """The other laws in its fits."""

    @property
    def law(self) -> Law:
        """Where and on what."""
        return self.spline.law

    @property
    def best(self) -> LawFit:
        """What is added to the model."""
        return self.formula or self.spline

    @property
    def score(self) -> float:
        """Of the better of the two."""
        return self.best.score

    @property
    def added(self) -> Parent:
        """The fit with the law, to add more to."""
        best = self.best
        return Parent(best.fit, best.validation, best.score, (*self.parent.made, best.made))


class LawSearch:
    """One search on a problem; what it drafts on its way stands in a folder of its own while it lasts."""

    def __init__(self, problem: Problem, work: Work, origin: Origin, say: Say) -> None:
        self.problem, self.work, self.origin, self.say = problem, work, origin, say
        self._folder = tempfile.TemporaryDirectory(prefix="needle-rig-laws-")
        self._drafts, self._rounds = 0, 0

    def __enter__(self) -> LawSearch:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def problem_of(self, parent: Parent) -> Problem:
        """The problem, its library with the laws in a fit."""
        return Shared(self.problem, parent.made).with_made()

    def promises(self, parent: Parent) -> list[Screened]:
        """What each law promises on top of a fit, best first."""
        self._rounds += 1
        every = candidates(self.problem, f"law{self._rounds}")
        taken = {each.law for each in parent.made}
        tasks = [(parent.fit, made) for made in every if made.law not in taken]
        found: list[Screened] = from_task(self.run(parent, screen, tasks))
        return sorted(found, key=lambda s: -s.gain)

    def on_top_of(self, parent: Parent, promised: Sequence[Screened]) -> list[FoundLaw]:
        """The laws that do best on top of a fit, best first, that with commands left out."""
        asked = asked_of(len(promised))
        raced = self._raced(parent, [s for s in promised if s.gain > asked])
        found = self._with_formulas([FoundLaw(rough, None, parent, parent.made) for rough in raced])
        leading = self._near(found)
        whole = self.run(parent, further_fit, [(parent, each.spline, True) for each in leading])
        judged = []
        for each, spline in zip(leading, whole, strict=True):
            formula = borne(each.formula, spline or each.spline)
            judged.append(dataclasses.replace(each, spline=spline or each.spline, formula=formula))
        judged.sort(key=lambda each: each.score)
        # one that its spline has left behind was found while that was still far off
        again = [
            dataclasses.replace(each, formula=None)
            if each.formula is not None and misses_more(each.formula, each.spline)
            else each
            for each in judged
        ]
        again = self._with_formulas(again)
        judged = [min(pair, key=lambda each: each.score) for pair in zip(again, judged, strict=True)]
        judged.sort(key=lambda each: each.score)
        judged[:1] = [self._followed(each) for each in judged[:1]]
        return [self._held_out(each) if place == 0 else each for place, each in enumerate(judged)]

    def without_law(self, current: Parent, law: Made, price: float) -> Parent | None:
        """A fit's parameters with a law of this price left out, all others where they are: what one in its
        place is added to."""
        made = tuple(each for each in current.made if each.name != law.name)
        rest = Parent(current.fit, NOT_HELD_OUT, current.score, made)
        effects, vector = _left_out(current.fit, law.name)
        at = fit(self.problem_of(rest), effects, vector, nuisance=current.fit.nuisance, iterations=0)
        if at is None:
            return None
        return dataclasses.replace(rest, fit=at, score=at.objective + current.price - price)

    def without_effect(self, current: Parent, name: str) -> Parent | None:
        """The fit without an effect of the library, with commands left out."""
        problem = self.problem_of(current)
        found = fit(problem, *_left_out(current.fit, name), nuisance=current.fit.nuisance)
        if found is None:
            return None
        saved = penalty(problem) * (current.fit.rank - found.rank)
        score = found.objective + current.price - saved
        return Parent(found, cross_validate(problem, found), score, current.made)

    def run(self, parent: Parent, task: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
        """What a task gives for each of its arguments, where the laws of a fit are known."""
        self.work.share(Shared(self.problem, parent.made))
        return self.work.run(task, tasks)

    def _raced(self, parent: Parent, leading: Sequence[Screened]) -> list[LawFit]:
        """The laws that lead after a few steps, the others left behind on the way; best first."""
        first = sorted(
            from_task(self.run(parent, first_fit, [(parent, s) for s in _spread(leading)])),
            key=lambda f: f.score,
        )
        going: list[LawFit] = [f for f in first if not self._far(f.score, first[0])][:FURTHER_FITS]
        further = self.run(parent, further_fit, [(parent, f, False) for f in going])
        best = [after or before for after, before in zip(further, going, strict=True)]
        return sorted(best, key=lambda f: f.score)[:WHOLE_FITS]

    def _far(self, score: float, best: LawFit) -> bool:
        """Whether a score is so far behind that of the best that it does not come near any more."""
        return score > best.score + BEHIND + excess(self.problem, best.fit.objective)

    def _near(self, found: Sequence[FoundLaw]) -> list[FoundLaw]:
        best = min(found, key=lambda each: each.score, default=None)
        return [each for each in found if best is not None and not self._far(each.score, best.best)]

    def _followed(self, found: FoundLaw) -> FoundLaw:
        """The law with its spline fitted anew from its formula, where that meets the data better."""
        if found.formula is None or not misses_more(found.spline, found.formula):
            return found
        (spline,) = self.run(found.parent, from_formula, [(found.parent, found.spline, found.formula)])
        better = spline is not None and spline.fit.chi2 < found.spline.fit.chi2
        return dataclasses.replace(found, spline=spline) if better else found

    def _held_out(self, found: FoundLaw) -> FoundLaw:
        (judged,) = self.run(found.parent, held_out, [(found.best,)])
        where = "spline" if found.formula is None else "formula"
        return dataclasses.replace(found, **{where: judged})

    def _with_formulas(self, found: Sequence[FoundLaw]) -> list[FoundLaw]:
        """The leading laws, those without a formula with the one that does best, if as well as the spline."""
        price, told = penalty(self.problem), list(found)
        for place, each in enumerate(found[:WITH_FORMULA]):
            if each.formula is not None or self._far(each.score, min(told, key=lambda t: t.score).best):
                continue
            spline = each.spline
            assert isinstance(spline.made, SplineLaw)
            assert spline.quadratic is not None
            assert spline.coefficients is not None
            starts = _starts_without(spline.fit, spline.made.name, each.parent.fit)
            rows = ranked(spline.made, spline.quadratic, spline.coefficients, price)[:FORMULAS]
            tasks = []
            for row in rows:
                first = _with_friction_of(self.problem, spline, row.formula, starts[0])
                tasks.append((each.parent, (first, *starts[1:]), self._drafted(spline.law, row.formula)))
            fitted: list[LawFit] = from_task(self.run(each.parent, fit_formula, tasks))
            best = min(fitted, key=lambda f: f.score, default=None)
            told[place] = dataclasses.replace(each, formula=borne(best, spline))
        return told

    def _drafted(self, law: Law, formula: Formula) -> FormulaLaw:
        self._drafts += 1
        path = Path(self._folder.name) / f"draft_{self._drafts}.py"
        written(path, law, formula, self.origin, self.problem.base.layout.tissue_sections_m)
        return FormulaLaw(law, path, formula)


def misses_more(one: LawFit, other: LawFit) -> bool:
    """Whether the data see that one of a law's spline and formula does not follow it: the other meets them
    better."""
    return one.fit.chi2 > other.fit.chi2 + POLICY.ties.close


def borne(formula: LawFit | None, spline: LawFit) -> LawFit | None:
    """The formula if the data bear it: it costs no more than the spline."""
    if formula is None or formula.score > spline.score:
        return None
    return formula


def asked_of(tried: int) -> float:
    """The gain that a law must have, the best of so many: what tells two explanations apart, and the price of
    having looked in so many places."""
    return POLICY.ties.close + 2.0 * float(np.log(max(tried, 1)))


def kept(problem: Problem, rival: Parent, found: FoundLaw, tried: int) -> bool:
    """Whether a law is there: better than its parent and the best of the library, by what is asked.

    Also at commands left out; and large enough to matter, and not our own error. A law whose model cannot be
    solved there, as that of a needle that snaps while its damping is still missing, is judged with what is
    found beside it: alone it does not reach the noise.
    """
    best, parent = found.best, found.parent
    asked = asked_of(tried)
    solved = np.isfinite(best.validation.error)
    for other in (parent, rival):
        if best.score > other.score - asked:
            return False
        if (
            solved
            and np.isfinite(other.validation.error)
            and not improves_cross_validation(other.validation, best.validation)
        ):
            return False
    if solved and np.isfinite(parent.validation.error) and not predicts(problem.size, parent, best):
        return False
    return not within_discretisation_error(problem, parent.fit, best.fit) and matters(
        problem, parent.fit, found
    )


def predicts(values: int, parent: Parent, best: LawFit) -> bool:
    """Whether χ² of so many values, predicted from the other commands, falls by what tells laws apart.

    What one command alone shows does not: there the predictive density rises by no more than the law's own
    uncertainty, which covers whatever that command has.
    """
    fall = parent.validation.error**2 - best.validation.error**2
    return bool(values * fall > POLICY.ties.close)


def matters(problem: Problem, parent: Fit, found: FoundLaw) -> bool:
    """Whether some reading changes by as much as counts, at once or as a root mean square over a trial."""
    with_it = Shared(problem, (found.best.made,)).with_made()
    before = problem.predict(parent.parameters, parent.vector)
    after = with_it.predict(found.best.fit.parameters, found.best.fit.vector)
    changes = [a - b for a, b in zip(after, before, strict=True)]
    return changes_matter(changes, problem.base.torque_scale)


def changes_matter(changes: Sequence[Array], torque_scale: float) -> bool:
    """Whether changes (readings, n) a trial, of the torque in N·m and angles in rad, count."""
    largest = np.max([np.nan_to_num(np.abs(change)).max(axis=1) for change in changes], axis=0)
    squares = [
        np.nansum(change**2, axis=1) / np.maximum(1, np.isfinite(change).sum(axis=1)) for change in changes
    ]
    rms = np.sqrt(np.max(squares, axis=0))
    size = POLICY.size
    return bool(
        nmm(float(largest[0])) > torque_scale * size.largest_nmm
        or deg(float(largest[1:].max())) > size.largest_deg
        or not size.small(nmm(float(rms[0])), "N·mm", torque_scale)
        or not size.small(deg(float(rms[1:].max())), "°")
    )


def tied(law: Law, score: float, others: Sequence[FoundLaw]) -> tuple[FoundLaw, ...]:
    """The others that cannot be told apart from a law of this score."""
    ties, known = list[FoundLaw](), [law]
    for each in others:
        # two kinds of one law, as two widths of a play, are reported alike
        if each.score < score + POLICY.ties.close and not any(each.law.same(k) for k in known):
            ties.append(each)
            known.append(each.law)
    return tuple(ties)


def _spread(promised: Sequence[Screened]) -> list[Screened]:
    """The leading ones, every torque and the best of each other hook.

    A linearised curve says too little of dry friction.
    """
    chosen = list(promised[:FIRST_FITS])
    for hook in ("torque", "shape", "drive", "observe"):
        own = [s for s in promised if s.made.law.hook == hook]
        chosen += [s for s in (own if hook == "torque" else own[:2]) if s not in chosen]
    return chosen


def _starts_without(found: Fit, name: str, parent: Fit) -> tuple[ParameterVector, ...]:
    """Where the fit with a law stands, and where its parent does, the law's own parameters left out."""
    return _left_out(found, name)[1], parent.vector


def _with_friction_of(
    problem: Problem, spline: LawFit, formula: Formula, vector: ParameterVector
) -> ParameterVector:
    """The spline's vector, the constant factor on slip limits by which a formula differs in its friction."""
    made = spline.made
    assert isinstance(made, SplineLaw)
    assert spline.coefficients is not None
    if made.law.place != "slip_limit":
        return vector
    at = seen(problem, made.law) / UNIT[made.law.variable_unit][2]
    beyond = made.spline.values(spline.coefficients, at) - made.unlinked(formula.at(at))
    return dataclasses.replace(vector, log_friction=vector.log_friction + float(beyond.mean()))


def _left_out(found: Fit, name: str) -> tuple[tuple[str, ...], ParameterVector]:
    """A fit's effects and its vector without one effect."""
    keep = [i for i, each in enumerate(found.parameters) if each.effect != name]
    vector = dataclasses.replace(found.vector, scaled_values=found.vector.scaled_values[keep])
    return tuple(each for each in found.effects if each != name), vector
