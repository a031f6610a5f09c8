"""Every way of aligning the needle, side by side on one simulated rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.fields import Within
from needle_rig.questions.question import AnyModel, OnSimulatedRig

if TYPE_CHECKING:
    from needle_rig.workbench.contest.contest import Contest


@dataclass(frozen=True, slots=True, kw_only=True)
class Strategies(OnSimulatedRig):
    """Run strategies on a simulated rig, from a relaxed and from a wound shaft."""

    names: Sequence[str] = ()
    """Strategies; none: all."""
    parameters: AnyModel = "rig_elastic"
    model: AnyModel | None = None
    """What planned works with; None: identified from eight runs on the rig."""
    diagnose: bool = False
    """Let diagnose find the effects of that model."""
    targets_deg: Sequence[float] = (15.0, -15.0, 45.0, -45.0, 90.0, -90.0, 180.0, -180.0)
    seeds: Annotated[int, Within(1, 1000)] = 3
    """Runs of each kind."""
    friction_scatter: Annotated[float, Within(0.0, 0.5)] = 0.05
    """Relative, from run to run."""

    def answer(self, doing: Doing = SILENT) -> Contest:
        """What each strategy left at the tip, beside what was predicted. Raises BadInput, SolverError."""
        from needle_rig.control.strategy import find_strategies
        from needle_rig.workbench.contest.contest import Asked, contest
        from needle_rig.workbench.contest.strategies_table import all_strategies
        from needle_rig.workbench.virtual.noise import Noise

        for _, sentence in find_strategies().broken:
            doing.tell(f"warning: {sentence}")
        noise = Noise(friction_scatter=self.friction_scatter)
        plant, library, model = self.plant(), self.library(doing), self.read_model(self.model)
        asked = Asked(tuple(self.names) or all_strategies(), tuple(self.targets_deg), self.seeds, noise)
        with doing.work(self) as work:
            return contest(
                plant,
                asked,
                library,
                model,
                diagnose=self.diagnose,
                work=work,
                say=doing.say,
                tell=doing.tell,
            )
