"""Where a model fails on measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.question import About

if TYPE_CHECKING:
    from needle_rig.workbench.learning.observations import Comparison


@dataclass(frozen=True, slots=True, kw_only=True)
class Compare(About):
    """Hold the model against data with its values as they stand, and beside them those of a refit."""

    refit: bool = False
    """Leave the column with the values as they stand out."""
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Values in the units of files that stand in place of the model's, and that no fit moves."""
    free: Sequence[str] = ()
    """Values that are fitted also where the model's others stand."""

    def answer(self, doing: Doing = SILENT) -> Comparison:
        """Where the model fails on the data, beside a refit. Raises BadInput, SolverError."""
        from needle_rig.workbench.learning.compare import Held

        saved, library, observed = self.saved(), self.library(doing), self.observed()
        held = Held(self.refit, self.fixed, tuple(self.free))
        return observed.compare(library, saved, held, doing.say)
