"""Constants of a rig from its own recordings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from needle_rig.errors import BadInput
from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.question import About

if TYPE_CHECKING:
    from needle_rig.model import SavedModel
    from needle_rig.workbench.learning.identify import Identification


@dataclass(frozen=True, slots=True)
class Identified:
    """Constants with their uncertainty, and the model whose values counted, too."""

    found: Identification
    before: SavedModel | None

    def saved(self, name: str) -> SavedModel:
        """The model with these values; those not identified stay as they were known before."""
        return self.found.saved(self.before, name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Identify(About):
    """Friction, its scatter, rigidity, damping and the values of the model, or what would give them."""

    update: bool = False
    """What the model knows counts, too."""

    def answer(self, doing: Doing = SILENT) -> Identified:
        """Constants with their uncertainty, and the model whose values counted too.

        Raises Contradiction where the data are not what the model predicts, BadInput, SolverError.
        """
        from needle_rig.workbench.learning.identify import identify, update

        saved = self.saved()
        if self.update and saved is None:
            raise BadInput("update needs a model whose values count; name one")
        library, dataset = self.library(doing), self.traces("identify constants")
        if saved is not None and self.update:
            return Identified(update(dataset, library, saved, doing.say), saved)
        return Identified(identify(dataset, library, saved.model if saved else None, doing.say), None)
