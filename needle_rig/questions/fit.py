"""Named effects fitted to traces, with the values that stay as they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.question import About

if TYPE_CHECKING:
    from needle_rig.workbench.learning.compare import TraceComparison


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit(About):
    """Fit the model with the effects `added` to traces."""

    added: Sequence[str] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Values in the units of files that no fit moves."""

    def answer(self, doing: Doing = SILENT) -> TraceComparison:
        """The fit of chosen effects, held against the data. Raises BadInput, SolverError."""
        from needle_rig.workbench.learning.fit_effects import fit_effects

        saved, library, dataset = self.saved(), self.library(doing), self.traces("fit values one by one")
        return fit_effects(dataset, library, saved, self.added, self.fixed, doing.say)
