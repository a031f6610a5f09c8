"""Laws as candidates: which of them does best on top of a fit, with a spline and with a formula.

Every law is screened; the leading ones are fitted inside the solver, a few steps at a time; those that stay
close get formulas, which are fitted in the spline's place. Whether one is taken is the search's to say.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem
from needle_rig.workbench.laws.draft import Origin, written
from needle_rig.workbench.laws.fitting import (
    LawFit,
    first_fit,
    fit_formula,
    from_formula,
    from_task,
    further_fit,
    held_out,
)
from needle_rig.workbench.laws.formulas import Formula, ranked
from needle_rig.workbench.laws.law import UNIT, Law
from needle_rig.workbench.laws.made import FormulaLaw
from needle_rig.workbench.laws.screening import Screened, candidates, screen, seen
from needle_rig.workbench.laws.spline_effect import SplineLaw
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.candidates import penalty, without
from needle_rig.workbench.selection.evidence import asked_of

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
    parent: Fit
    """What it was added to."""

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


class LawCandidates:
    """The laws on top of fits to one problem; drafts stand in a folder of their own while this lasts.

    `work` shares the problem whose library has all effects of the fits.
    """

    def __init__(self, work: Work, origin: Origin) -> None:
        self.work, self.origin = work, origin
        self._folder = tempfile.TemporaryDirectory(prefix="needle-rig-laws-")
        self._drafts, self._rounds = 0, 0

    def __enter__(self) -> LawCandidates:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def screened(self, problem: Problem, parent: Fit, taken: Collection[Law]) -> list[Screened]:
        """What each law but those that are taken promises on top of a fit, best first."""
        self._rounds += 1
        every = candidates(problem, f"law{self._rounds}")
        tasks = [(parent, made) for made in every if made.law not in taken]
        found: list[Screened] = from_task(self.work.run(screen, tasks))
        return sorted(found, key=lambda s: -s.gain)

    def on_top_of(self, problem: Problem, parent: Fit, promised: Sequence[Screened]) -> list[FoundLaw]:
        """The laws that do best on top of a fit, best first, that with commands left out."""
        asked = asked_of(len(promised))
        raced = self._raced(problem, parent, [s for s in promised if s.gain > asked])
        found = self._with_formulas(problem, [FoundLaw(rough, None, parent) for rough in raced])
        leading = _near(problem, found)
        whole = self.work.run(further_fit, [(each.spline, True) for each in leading])
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
        again = self._with_formulas(problem, again)
        judged = [min(pair, key=lambda each: each.score) for pair in zip(again, judged, strict=True)]
        judged.sort(key=lambda each: each.score)
        judged[:1] = [self._held_out(self._followed(each)) for each in judged[:1]]
        return judged

    def _raced(self, problem: Problem, parent: Fit, leading: Sequence[Screened]) -> list[LawFit]:
        """The laws that lead after a few steps, the others left behind on the way; best first."""
        first = sorted(
            from_task(self.work.run(first_fit, [(parent, s) for s in _spread(leading)])),
            key=lambda f: f.score,
        )
        going: list[LawFit] = [f for f in first if not _far(problem, f.score, first[0])][:FURTHER_FITS]
        further = self.work.run(further_fit, [(f, False) for f in going])
        best = [after or before for after, before in zip(further, going, strict=True)]
        return sorted(best, key=lambda f: f.score)[:WHOLE_FITS]

    def _followed(self, found: FoundLaw) -> FoundLaw:
        """The law with its spline fitted anew from its formula, where that meets the data better."""
        if found.formula is None or not misses_more(found.spline, found.formula):
            return found
        (spline,) = self.work.run(from_formula, [(found.spline, found.formula)])
        better = spline is not None and spline.fit.chi2 < found.spline.fit.chi2
        return dataclasses.replace(found, spline=spline) if better else found

    def _held_out(self, found: FoundLaw) -> FoundLaw:
        (judged,) = self.work.run(held_out, [(found.best,)])
        where = "spline" if found.formula is None else "formula"
        return dataclasses.replace(found, **{where: judged})

    def _with_formulas(self, problem: Problem, found: Sequence[FoundLaw]) -> list[FoundLaw]:
        """The leading laws, those without a formula with the one that does best, if as well as the spline."""
        price, told = penalty(problem), list(found)
        for place, each in enumerate(found[:WITH_FORMULA]):
            if each.formula is not None or _far(problem, each.score, min(told, key=lambda t: t.score).best):
                continue
            spline = each.spline
            assert isinstance(spline.made, SplineLaw)
            assert spline.quadratic is not None
            assert spline.coefficients is not None
            # where the fit with the spline stands, and where its parent does
            starts = (without(spline.fit, spline.made.name), each.parent.vector)
            rows = ranked(spline.made, spline.quadratic, spline.coefficients, price)[:FORMULAS]
            tasks = []
            for row in rows:
                first = _with_friction_of(problem, spline, row.formula, starts[0])
                drafted = self._drafted(problem, spline.law, row.formula)
                tasks.append((each.parent, (first, *starts[1:]), drafted))
            fitted: list[LawFit] = from_task(self.work.run(fit_formula, tasks))
            best = min(fitted, key=lambda f: f.score, default=None)
            told[place] = dataclasses.replace(each, formula=borne(best, spline))
        return told

    def _drafted(self, problem: Problem, law: Law, formula: Formula) -> FormulaLaw:
        self._drafts += 1
        path = Path(self._folder.name) / f"draft_{self._drafts}.py"
        written(path, law, formula, self.origin, problem.base.layout.tissue_sections_m)
        return FormulaLaw(law, path, formula)


def without_law(problem: Problem, found: Fit, name: str) -> Fit | None:
    """A fit's parameters with a law left out, all others where they are: what one in its place is added
    to."""
    names = tuple(each for each in found.effects if each != name)
    return fit(problem, names, without(found, name), nuisance=found.nuisance, iterations=0)


def _far(problem: Problem, score: float, best: LawFit) -> bool:
    """Whether a score is so far behind that of the best that it does not come near any more."""
    return score > best.score + BEHIND + excess(problem, best.fit.objective)


def _near(problem: Problem, found: Sequence[FoundLaw]) -> list[FoundLaw]:
    best = min(found, key=lambda each: each.score, default=None)
    return [each for each in found if best is not None and not _far(problem, each.score, best.best)]


def misses_more(one: LawFit, other: LawFit) -> bool:
    """Whether the data see that one of a law's spline and formula does not follow it: the other meets them
    better."""
    return one.fit.chi2 > other.fit.chi2 + POLICY.ties.close


def borne(formula: LawFit | None, spline: LawFit) -> LawFit | None:
    """The formula if the data bear it: it costs no more than the spline."""
    if formula is None or formula.score > spline.score:
        return None
    return formula


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
