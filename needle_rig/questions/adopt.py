"""What is missing, added to a model; and the step taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from needle_rig.errors import BadInput
from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.question import About, AnyData, AnyModel, PathLike, Question, read_observations

if TYPE_CHECKING:
    from needle_rig.model import SavedModel
    from needle_rig.workbench.learning.diagnosis_file import KeptDiagnosis

    AnyDiagnosis: TypeAlias = PathLike | KeptDiagnosis
else:
    AnyDiagnosis = object


@dataclass(frozen=True, slots=True, kw_only=True)
class Adopt(Question):
    """The model that was diagnosed, with all effects that the diagnosis names, as they were fitted."""

    diagnosis: AnyDiagnosis
    """Diagnosis file, or what Diagnosed keeps."""
    data: AnyData | None = None
    """Those of the diagnosis, to hold its fit against; None: it is taken as it is."""
    chosen: Sequence[str] = ()
    """Which of its ties."""
    force: bool = False
    """Also where the error on commands left out does not fall."""
    name: str | None = None
    """Of a model that learnt nothing before; one that did keeps its own."""

    def answer(self, doing: Doing = SILENT) -> SavedModel:
        """The model with what the diagnosis names. Raises Refused, BadInput, SolverError."""
        from needle_rig.workbench.learning.adopt import adopt_diagnosis
        from needle_rig.workbench.learning.diagnosis_file import KeptDiagnosis, load_diagnosis

        kept = self.diagnosis
        if not isinstance(kept, KeptDiagnosis):
            kept = load_diagnosis(kept, effects=self.folders())
        observed = read_observations(self.data) if self.data is not None else None
        doing.say("holding the fit against the data")
        name = None if kept.learnt else self.name
        return adopt_diagnosis(kept, observed, effects=self.chosen, force=self.force, name=name)


@dataclass(frozen=True, slots=True, kw_only=True)
class AddEffect(About):
    """The model with one effect more, everything fitted again to the data."""

    effect: str
    force: bool = False
    """Also where the error on commands left out does not fall."""
    name: str | None = None
    """Of the model that was the null model; another keeps its own."""

    def answer(self, doing: Doing = SILENT) -> SavedModel:
        """The model with `effect`, fitted again. Raises Refused, BadInput, SolverError."""
        from needle_rig.workbench.learning.adopt import adopt

        saved, library, observed = self.saved(), self.library(doing), self.observed()
        doing.say(f"fitting {self.effect}")
        name = None if saved else self.name
        return adopt(observed, self.effect, library, saved, force=self.force, name=name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Undo(Question):
    """The model before its last step."""

    model: AnyModel

    def answer(self, doing: Doing = SILENT) -> SavedModel:
        """The model before its last step. Raises BadInput."""
        from needle_rig.workbench.learning.adopt import undo

        saved = self.read_model(self.model)
        if saved is None:
            raise BadInput("the null model has no step to take back; name a model")
        doing.say("taking the last step back")
        return undo(saved)
