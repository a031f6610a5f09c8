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
    """What was made before it and is in its fits."""
    at: float | None = None
    """Score as all laws were last fitted together, where that is another."""

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
        return self.best.score if self.at is None else self.at


class LawSearch:
    """One search on a problem; what it drafts on its way stands in a folder of its own while it lasts."""

    def __init__(self, problem: Problem, work: Work, origin: Origin, say: Say) -> None:
        self.problem, self.work, self.origin, self.say = problem, work, origin, say
        self.made: tuple[Made, ...] = ()
        self._folder = tempfile.TemporaryDirectory(prefix="needle-rig-laws-")
        self._drafts, self._rounds = 0, 0

    def __enter__(self) -> LawSearch:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def whole_problem(self) -> Problem:
        """The problem, its library with every law that was added."""
        return Shared(self.problem, self.made).with_made()

    def promises(self, parent: Parent) -> list[Screened]:
        """What each law promises on top of a fit, best first."""
        self._rounds += 1
        every = candidates(self.problem, f"law{self._rounds}")
        taken = {each.law for each in self.made}
        tasks = [(parent.fit, made) for made in every if made.law not in taken]
        found: list[Screened] = from_task(self._run(screen, tasks))
        return sorted(found, key=lambda s: -s.gain)

    def on_top_of(self, parent: Parent, promised: Sequence[Screened]) -> list[FoundLaw]:
        """The laws that do best on top of a fit, best first, that with commands left out."""
        asked = asked_of(len(promised))
        raced = self._raced(parent, [s for s in promised if s.gain > asked])
        found = self._with_formulas([FoundLaw(rough, None, parent, self.made) for rough in raced])
        leading = self._near(found)
        whole = self._run(further_fit, [(parent, each.spline, True) for each in leading])
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

    def add(self, found: FoundLaw) -> Parent:
        """The fit with the law, to add more to."""
        self.made = (*self.made, found.best.made)
        return Parent(found.best.fit, found.best.validation, found.best.score)

    def without(self, current: Parent, old: FoundLaw) -> Parent | None:
        """A fit's parameters with a law left out, all others where they are: what a law in its place is added
        to."""
        name = old.best.made.name
        problem = Shared(self.problem, self._others(old)).with_made()
        effects = tuple(e for e in current.fit.effects if e != name)
        vector = _vector_without(current.fit, name)
        at = fit(problem, effects, vector, nuisance=current.fit.nuisance, iterations=0)
        if at is None:
            return None
        return Parent(at, NOT_HELD_OUT, at.objective + current.price - old.best.price)

    def without_effect(self, current: Parent, name: str) -> Parent | None:
        """The fit without an effect of the library, with commands left out."""
        problem = self.whole_problem()
        effects = tuple(e for e in current.fit.effects if e != name)
        found = fit(problem, effects, _vector_without(current.fit, name), nuisance=current.fit.nuisance)
        if found is None:
            return None
        saved = penalty(problem) * (current.fit.rank - found.rank)
        return Parent(found, cross_validate(problem, found), found.objective + current.price - saved)

    def in_place_of(self, old: FoundLaw, rest: Parent) -> list[FoundLaw]:
        """The laws that do best on top of a fit that an earlier one was left out of."""
        made = self.leave(old)
        found = self.on_top_of(rest, self.promises(rest))
        self.made = made
        return found

    def put(self, old: FoundLaw, new: FoundLaw) -> Parent:
        """The fit with a law in the place of an earlier one, to add more to."""
        self.made = self._others(old)
        return self.add(new)

    def leave(self, old: FoundLaw) -> tuple[Made, ...]:
        """Go on without a law; what was made before, to go back to."""
        made, self.made = self.made, self._others(old)
        return made

    def _others(self, old: FoundLaw) -> tuple[Made, ...]:
        return tuple(each for each in self.made if each.name != old.best.made.name)

    def _run(self, task: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
        self.work.share(Shared(self.problem, self.made))
        return self.work.run(task, tasks)

    def _raced(self, parent: Parent, leading: Sequence[Screened]) -> list[LawFit]:
        """The laws that lead after a few steps, the others left behind on the way; best first."""
        first = sorted(
            from_task(self._run(first_fit, [(parent, s) for s in _spread(leading)])), key=lambda f: f.score
        )
        going: list[LawFit] = [f for f in first if not self._far(f.score, first[0])][:FURTHER_FITS]
        further = self._run(further_fit, [(parent, f, False) for f in going])
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
        (spline,) = self._run(from_formula, [(found.parent, found.spline, found.formula)])
        better = spline is not None and spline.fit.chi2 < found.spline.fit.chi2
        return dataclasses.replace(found, spline=spline) if better else found

    def _held_out(self, found: FoundLaw) -> FoundLaw:
        (judged,) = self._run(held_out, [(found.best,)])
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
            fitted: list[LawFit] = from_task(self._run(fit_formula, tasks))
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


def kept(problem: Problem, parent: Parent, rival: Parent, found: FoundLaw, tried: int) -> bool:
    """Whether a law is there: better than its parent and the best of the library, by what is asked.

    Also at commands left out; and large enough to matter, and not our own error. A law whose model cannot be
    solved there, as that of a needle that snaps while its damping is still missing, is judged with what is
    found beside it: alone it does not reach the noise.
    """
    best = found.best
    asked = asked_of(tried)
    solved = np.isfinite(best.validation.error)
    for other in (parent, rival):
        if best.score > other.score - asked:
            return False
        if (
            solved
            and np.isfinite(other.validation.error)
            and not improves_cross_validation(other.fit, other.validation, best.fit, best.validation)
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


def tied(found: Sequence[FoundLaw]) -> tuple[FoundLaw, ...]:
    """The laws that cannot be told apart from the first."""
    if not found:
        return ()
    ties, known = [], [found[0].law]
    for each in found[1:]:
        # two kinds of one law, as two widths of a play, are reported alike
        if each.score < found[0].score + POLICY.ties.close and not any(each.law.same(k) for k in known):
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
    return _vector_without(found, name), parent.vector


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


def _vector_without(found: Fit, name: str) -> ParameterVector:
    keep = [i for i, each in enumerate(found.parameters) if each.effect != name]
    return dataclasses.replace(found.vector, scaled_values=found.vector.scaled_values[keep])
