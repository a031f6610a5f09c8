"""Effects that a search makes: a law with a spline, or with a formula."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from needle_rig.physics.effect import Effect
from needle_rig.physics.library import load_effect
from needle_rig.workbench.estimation.problem import Fit
from needle_rig.workbench.laws.formulas import Formula
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.spline_effect import SplineLaw


@dataclass(frozen=True)
class FormulaLaw:
    """A law with a formula, in an effect file."""

    law: Law
    path: Path
    formula: Formula
    """As it was drafted: a fit moves its numbers."""

    @property
    def name(self) -> str:
        """Of the effect: that of the file."""
        return self.path.stem

    def effect(self) -> type[Effect]:
        """The effect. Raises BadInput where the file is none."""
        return load_effect(self.path)

    def formula_at(self, found: Fit) -> Formula:
        """The formula with its numbers as they are in a fit."""
        own = [
            parameter.value(float(at))
            for parameter, at in zip(found.parameters, found.vector.scaled_values, strict=True)
            if parameter.effect == self.name
        ]
        return dataclasses.replace(self.formula, values=tuple(own[: len(self.formula.values)]))


Made = SplineLaw | FormulaLaw
