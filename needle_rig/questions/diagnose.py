"""Which effect is missing from a model."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.fields import Within
from needle_rig.questions.question import About

if TYPE_CHECKING:
    from needle_rig.model import SavedModel
    from needle_rig.workbench.learning.compare import TraceComparison
    from needle_rig.workbench.learning.diagnosis_file import KeptDiagnosis
    from needle_rig.workbench.learning.observations import Observations
    from needle_rig.workbench.selection.answer import Answer
    from needle_rig.workbench.selection.documents import DiagnoseDocument, ValuesDocument


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """A diagnosis, with what was asked: data and model."""

    found: Answer
    observed: Observations
    started: SavedModel | None
    """The model that was diagnosed; None for the null model."""

    def compared(self) -> TraceComparison | None:
        """Where the model that was diagnosed fails; None for settled values."""
        from needle_rig.workbench.learning.compare import compared
        from needle_rig.workbench.selection.diagnose import Diagnosis

        found = self.found
        return compared(found.baseline, self.started) if isinstance(found, Diagnosis) else None

    def model_values(self) -> ValuesDocument | None:
        """Whether the model's values hold as they stand; None for settled values and the null model."""
        from needle_rig.workbench.learning.compare import values_document

        held = None if self.started is None else self.compared()
        if held is None:
            return None
        return values_document(held, structure_holds=self.found.verdict == "none")

    def as_json(self) -> DiagnoseDocument:
        """The stated form of the answer."""
        from needle_rig.workbench.selection.way_on import way_on

        document, values = self.found.as_json(), self.model_values()
        if values is not None:
            document["model_values"] = values
        if self.found.verdict == "unknown":
            document["way_on"] = way_on(self.found).as_json()
        return document

    def keep(self) -> KeptDiagnosis:
        """The diagnosis with its fits, as it is written."""
        from needle_rig.workbench.learning.diagnosis_file import keep

        return keep(self.found, self.observed, self.started)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the diagnosis file that `adopt` takes."""
        from needle_rig.workbench.learning.diagnosis_file import save_diagnosis

        save_diagnosis(path, self.keep())

    def told(self) -> dict[str, Any]:
        """The stated form with the sentences that people read, as page and report show it."""
        found = self.found
        return {
            **{name: part for name, part in self.as_json().items() if name != "policy"},
            "sentence": found.sentence(),
            "errors_sentence": found.errors_sentence(),
            "ties": list(found.ties),
            "left_over": found.left_in_words(),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnose(About):
    """Say which effect is missing from the model: its size, its rivals, and what the data cannot tell."""

    max_effects: Annotated[int, Within(1, 6)] = 3
    quick: bool = False
    """Look for one effect alone."""

    def answer(self, doing: Doing = SILENT) -> Diagnosed:
        """The effect that is missing, with its rivals and the verdict. Raises BadInput, SolverError."""
        saved, library, observed = self.saved(), self.library(doing), self.observed()
        with doing.work(self) as work:
            found = observed.diagnose(
                library,
                None if saved is None else saved.model,
                max_effects=self.max_effects,
                quick=self.quick,
                work=work,
                say=doing.say,
            )
        return Diagnosed(found, observed, saved)

    def write_report(
        self,
        told: Mapping[str, Any],
        kept: KeptDiagnosis,
        compared: TraceComparison | None,
        path: str | os.PathLike[str],
    ) -> None:
        """Write the answer as one HTML file with all that it shows. Raises OSError."""
        from needle_rig.figures.diagnosis import Asked, write_html

        file = Path(self.model) if isinstance(self.model, str | os.PathLike) else None
        if file is not None and not file.is_file():  # the name of a parameter set
            file = None
        words = "one effect alone" if self.quick else f"up to {self.max_effects} effects together"
        own = tuple(f"effects of {Path(folder).name}" for folder in self.folders())
        asked = Asked(
            "" if file is None else file.name,
            "" if file is None else hashlib.sha256(file.read_bytes()).hexdigest(),
            (words, *own),
        )
        write_html(told, kept, asked, compared, Path(path))
