"""The search for laws: one after the other on top of what the library explains, each judged as an effect.

Every law is screened; the leading ones are fitted inside the solver, those that stay close get formulas,
which are fitted in the spline's place. A law is kept when it does better than every library effect and than
chance, also on commands left out, and cannot be our own error.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.problem import ParameterVector, Problem
from needle_rig.workbench.laws.draft import Origin, written
from needle_rig.workbench.laws.fitting import (
    FormulaLaw,
    LawFit,
    Made,
    Screened,
    Shared,
    candidates,
    fit_formula,
    fit_spline,
    from_task,
    screen,
)
from needle_rig.workbench.laws.formulas import Formula, ranked
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.spline_effect import SplineLaw
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.evidence import improves_cross_validation, within_discretisation_error
from needle_rig.workbench.selection.search import penalty

Say = Callable[[str], None]

FIRST_FITS = 10
"""Laws that are fitted for a few steps,"""
WHOLE_FITS = 4
"""to the end,"""
WITH_FORMULA = 3
"""and with formulas,"""
FORMULAS = 4
"""of which so many forms are fitted inside the solver."""


@dataclass(frozen=True)
class Parent:
    """What laws are added to: a fit with its held-out error, and its score on the scale of laws."""

    fit: Fit
    validation: CrossValidation
    score: float


@dataclass(frozen=True)
class FoundLaw:
    """A law with its best spline and, where the data bear one, its formula."""

    spline: LawFit
    formula: LawFit | None
    parent: Parent

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


class LawSearch:
    """One search on a problem; what it drafts on its way stands in a folder of its own while it lasts."""

    def __init__(self, problem: Problem, work: Work, origin: Origin, say: Say) -> None:
        self.problem, self.work, self.origin, self.say = problem, work, origin, say
        self.made: tuple[Made, ...] = ()
        self._folder = tempfile.TemporaryDirectory(prefix="needle-rig-laws-")
        self._drafts = 0

    def __enter__(self) -> LawSearch:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def whole_problem(self) -> Problem:
        """The problem, its library with every law that was added."""
        return Shared(self.problem, self.made).with_made()

    def promises(self, parent: Parent) -> list[Screened]:
        """What each law promises on top of a fit, best first."""
        self._share()
        every = candidates(self.problem, f"law{len(self.made) + 1}")
        taken = {each.law for each in self.made}
        tasks = [(parent.fit, made) for made in every if made.law not in taken]
        found: list[Screened] = from_task(self.work.run(screen, tasks))
        return sorted(found, key=lambda s: -s.gain)

    def on_top_of(self, parent: Parent, promised: Sequence[Screened]) -> list[FoundLaw]:
        """The laws that do best on top of a fit, best first."""
        asked = asked_of(len(promised))
        leading = [s for s in promised if s.gain > asked]
        first = self._fits(parent, _spread(leading), whole=False)
        chosen = first[:WHOLE_FITS]
        by_name = {s.made.name: s for s in leading}
        splines = self._fits(parent, [by_name[f.made.name] for f in chosen], whole=True)
        found = [FoundLaw(spline, None, parent) for spline in splines]
        return sorted(self._with_formulas(found), key=lambda each: each.score)

    def add(self, found: FoundLaw) -> Parent:
        """The fit with the law, to add more to."""
        self.made = (*self.made, found.best.made)
        return Parent(found.best.fit, found.best.validation, found.best.score)

    def _share(self) -> None:
        self.work.share(Shared(self.problem, self.made))

    def _fits(self, parent: Parent, promised: Sequence[Screened], *, whole: bool) -> list[LawFit]:
        self._share()
        tasks = [(parent.fit, s, whole) for s in promised]
        found: list[LawFit] = from_task(self.work.run(fit_spline, tasks))
        return sorted(found, key=lambda f: f.score)

    def _with_formulas(self, found: list[FoundLaw]) -> list[FoundLaw]:
        """The leading laws with the formula that does best, where one does as well as the spline."""
        price = penalty(self.problem)
        tasks, owners = [], []
        for place, each in enumerate(found[:WITH_FORMULA]):
            spline = each.spline
            assert isinstance(spline.made, SplineLaw)
            assert spline.quadratic is not None
            starts = _starts_without(spline.fit, spline.made.name, each.parent.fit)
            for row in ranked(spline.law, spline.made.spline, spline.quadratic, price)[:FORMULAS]:
                made = self._drafted(spline.law, row.formula)
                tasks.append((each.parent.fit, starts, made))
                owners.append(place)
        self._share()
        best: dict[int, LawFit] = {}
        for place, fitted in zip(owners, self.work.run(fit_formula, tasks), strict=True):
            if fitted is not None and (place not in best or fitted.score < best[place].score):
                best[place] = fitted
        return [
            dataclasses.replace(each, formula=borne(best.get(place), each.spline))
            for place, each in enumerate(found)
        ]

    def _drafted(self, law: Law, formula: Formula) -> FormulaLaw:
        self._drafts += 1
        path = Path(self._folder.name) / f"law{len(self.made) + 1}_draft_{self._drafts}.py"
        written(path, law, formula, self.origin, self.problem.base.layout.tissue_sections_m)
        return FormulaLaw(law, path, formula)


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

    Also at commands left out; and large enough to matter, and not our own error.
    """
    best = found.best
    asked = asked_of(tried)
    for other in (parent, rival):
        if best.score > other.score - asked:
            return False
        if np.isfinite(other.validation.error) and not improves_cross_validation(
            other.fit, other.validation, best.fit, best.validation
        ):
            return False
    return not within_discretisation_error(problem, parent.fit, best.fit) and matters(
        problem, parent.fit, found
    )


def matters(problem: Problem, parent: Fit, found: FoundLaw) -> bool:
    """Whether some reading changes by as much as counts."""
    with_it = Shared(problem, (found.best.made,)).with_made()
    before = problem.predict(parent.parameters, parent.vector)
    after = with_it.predict(found.best.fit.parameters, found.best.fit.vector)
    change = np.hstack([a - b for a, b in zip(after, before, strict=True)])
    largest = np.nanmax(np.abs(change), axis=1)
    size = POLICY.size
    most_nmm = problem.base.torque_scale * size.largest_nmm
    return bool(nmm(float(largest[0])) > most_nmm or deg(float(largest[1:].max())) > size.largest_deg)


def tied(found: Sequence[FoundLaw]) -> tuple[FoundLaw, ...]:
    """The laws that cannot be told from the first."""
    if not found:
        return ()
    first = found[0]
    return tuple(each for each in found[1:] if each.score < first.score + POLICY.ties.close)


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
    keep = [i for i, each in enumerate(found.parameters) if each.effect != name]
    return dataclasses.replace(found.vector, scaled_values=found.vector.scaled_values[keep]), parent.vector
