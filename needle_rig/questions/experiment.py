"""The trial that would best tell two effects apart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.question import About, PathLike

if TYPE_CHECKING:
    from needle_rig.workbench.learning.experiment import Experiment as Proposed


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment(About):
    """Propose the trial that would best separate two effects, within the limits of a rig."""

    between: tuple[str, str]
    rig: PathLike | None = None
    """Rig file whose limits hold; None: the shipped one."""

    def answer(self, doing: Doing = SILENT) -> Proposed:
        """The trial that tells two effects apart best. Raises BadInput, SolverError."""
        from needle_rig.workbench.learning.experiment import propose_experiment

        saved, library, dataset = self.saved(), self.library(doing), self.traces("fit both effects")
        model, rig = saved.model if saved else None, None if self.rig is None else Path(self.rig)
        with doing.work(self) as work:
            return propose_experiment(
                dataset, self.between, library, model, rig=rig, work=work, say=doing.say
            )
