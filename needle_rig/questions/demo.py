"""The closed circle on a simulated rig that hides something."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from needle_rig.errors import BadInput
from needle_rig.folders import temporary_folder
from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.fields import Within
from needle_rig.questions.learn import free_place
from needle_rig.questions.question import OnSimulatedRig, PathLike

if TYPE_CHECKING:
    from needle_rig.workbench.contest.demo import Story


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo(OnSimulatedRig):
    """Runs with reed2008, diagnose, adopt, and planned with the new model on fresh needles.

    A rig without any effect hides elastic tissue.
    """

    law: bool = False
    """Hide a law that no effect holds; learn takes the place of diagnose."""
    draft: PathLike | None = None
    """Effect file to write of that law; None: none is left."""
    target_deg: Annotated[float, Within(-360.0, 360.0)] = 45.0
    runs: Annotated[int, Within(1, 100)] = 8
    seed: Annotated[int, Within(0)] = 1

    def answer(self, doing: Doing = SILENT) -> Story:
        """What was hidden, what was named, and what that changed. Raises BadInput, SolverError."""
        if self.target_deg == 0.0:
            raise BadInput("target_deg 0: there is nothing to turn; give up to ±360 degrees")
        if self.law and self.hidden:
            raise BadInput("law hides one of its own; name no effect beside it")
        from needle_rig.workbench.contest.demo import tell_law_story, tell_story
        from needle_rig.workbench.contest.untold_law import SECTION

        library, plant = self.library(doing), self.plant()
        if not self.law:
            if not (plant.effects or self.hidden):
                plant = replace(self, hidden=("tissue_elasticity=0.3",)).plant()
            with doing.work(self) as work:
                return tell_story(
                    plant,
                    library,
                    target_deg=self.target_deg,
                    runs=self.runs,
                    seed=self.seed,
                    work=work,
                    say=doing.say,
                )
        if (sections := len(plant.layout.tissue_sections_m)) < SECTION:
            raise BadInput(
                f"the law acts in tissue section {SECTION}, and {plant.name} has {sections}; name another"
                " parameter set"
            )
        with temporary_folder("needle-rig-demo-") as folder, doing.work(self) as work:
            draft = folder / "learnt_law.py" if self.draft is None else Path(self.draft)
            return tell_law_story(
                plant,
                library,
                free_place(draft, set(library)),
                target_deg=self.target_deg,
                runs=self.runs,
                seed=self.seed,
                work=work,
                say=doing.say,
            )
