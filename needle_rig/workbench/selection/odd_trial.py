"""One trial that differs from all others, as after a bump against the table.

What a model leaves in a trial, in units of the noise, goes from trial to trial with what it lacks. Its
logarithm in one trial is held against those in all others: Grubbs' test for one outlier (Technometrics 11,
1969, as the t test of the deleted residual, with Bonferroni's correction for the choice of the trial). What
the model lacks may show at one command alone. So a trial is called odd where its command was repeated and the
repetition has none of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from needle_rig.dataset import Dataset
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.policy import POLICY

FEWEST = 4
"""Trials of which one can be odd: of three, two others show no spread worth the name."""


@dataclass(frozen=True)
class OddTrial:
    """A trial in which a fit leaves far more than in all others."""

    index: int
    """Its place in the series."""
    file: str
    left: float
    """Root mean square of the residual in it, in units of the noise."""
    others: float
    """The same of all others together."""
    p: float
    """That chance makes one of so many trials differ by as much."""
    repeated: bool
    """Whether another trial of its command is among the others."""

    def sentence(self, *, left_out: bool) -> str:
        """In words; `left_out`: the answer is that of the other trials."""
        differs = (
            f"{self.file} differs from all other trials: what is left in it is {self.left:.2g} × the noise,"
            f" in the others together {self.others:.2g} × (p = {self.p:.1g})"
        )
        if not self.repeated:
            return (
                f"{differs}. Its command was not repeated, so that what happened in it and what the model"
                " lacks at that command look alike: repeat it."
            )
        alone = f"{differs}, and a repetition of its command shows nothing of it."
        return f"{alone} It is left out of this answer." if left_out else alone


def odd_trial(problem: Problem, found: Fit) -> OddTrial | None:
    """The trial that differs from all others in what `found` leaves of it, None where none does."""
    values = np.bincount(problem.recorded, [r.size for r in found.residuals])
    squares = np.bincount(problem.recorded, [float(r @ r) for r in found.residuals])
    p = chance_of_largest(squares / values)
    if p >= POLICY.evidence.false_alarm:
        return None
    odd = int(np.argmax(squares / values))
    places = np.flatnonzero(problem.recorded == odd).tolist()
    first = problem.trials[places[0]]
    others = np.delete(np.arange(squares.size), odd)
    return OddTrial(
        first.trial.index,
        first.file.partition(",")[0],
        float(np.sqrt(squares[odd] / values[odd])),
        float(np.sqrt(squares[others].sum() / values[others].sum())),
        p,
        any(problem.recorded[t] != odd for group in problem.groups if places[0] in group for t in group),
    )


def chance_of_largest(mean_squares: Sequence[float] | np.ndarray) -> float:
    """Chance that the largest of some mean squares, one a trial, lies so far above the others; 1 where it
    cannot be told."""
    sizes = np.asarray(mean_squares, dtype=float)
    if sizes.size < FEWEST or not np.all(sizes > 0.0):
        return 1.0
    logarithms = np.log(sizes)
    odd = int(np.argmax(logarithms))
    others = np.delete(logarithms, odd)
    spread = float(others.std(ddof=1)) * np.sqrt(1.0 + 1.0 / others.size)
    if not spread > 0.0:
        return 1.0
    t = float(logarithms[odd] - others.mean()) / spread
    return min(1.0, sizes.size * float(stdtr(others.size - 1, -t)))


def without(dataset: Dataset, odd: OddTrial) -> Dataset:
    """The dataset without the trial; the others keep their places in the series."""
    trials = tuple(t for t in dataset.trials if t.trial.index != odd.index)
    return dataclasses.replace(dataset, trials=trials)
