"""What planning may spend, in the solver's own unit: it ends in time without looking at a clock."""

from __future__ import annotations

from needle_rig.errors import SolverError
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.solution import RodState, Solution

CALL_SOLVES = 150.0
LAW_SOLVES = 2.0
"""What a call of the solver costs besides its solves, and what a solve with torque laws costs, in solves of
1 µs: one with laws takes 1.8 µs."""
MOST_SOLVES = 30_000.0
"""Of one sequence: above all but those of needles that snap all the way."""


class Spent(Exception):
    """Nothing is left: what was found so far must do."""


class Effort:
    """Solves that may still be spent, by themselves or as a part of a whole."""

    def __init__(self, solves: float, whole: Effort | None = None) -> None:
        self.left = solves
        self._whole = whole

    def part(self, share: float) -> Effort:
        """A share of the rest; what it does not spend stays with the whole."""
        return Effort(share * self.left, self)

    def truth(self, model: NeedleModel, trial: Trial, state: RodState) -> Solution:
        """`model.truth`, paid for. Raises Spent, and SolverError when this trial took too much by itself."""
        price = LAW_SOLVES if model.acting("torque") else 1.0
        affordable = (self.left - CALL_SOLVES) / price
        if affordable <= 0.0:
            raise Spent
        most = min(affordable, MOST_SOLVES)
        try:
            solution = model.truth(trial, state, most_solves=most)
        except SolverError:
            self._spend(CALL_SOLVES + most * price)
            if most < MOST_SOLVES:
                raise Spent from None
            raise
        self._spend(CALL_SOLVES + solution.solves * price)
        return solution

    def _spend(self, solves: float) -> None:
        self.left -= solves
        if self._whole is not None:
            self._whole._spend(solves)
