"""A law that no effect holds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from needle_rig.errors import BadInput
from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.question import About, PathLike

if TYPE_CHECKING:
    from needle_rig.workbench.laws.learnt import Learnt


@dataclass(frozen=True, slots=True)
class Laws:
    """What was learnt, and the effect files that were drafted of it."""

    found: Learnt
    drafts: tuple[Path, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Learn(About):
    """Where a law acts that no effect holds, what it depends on, its curve and a short formula."""

    draft: PathLike | None = None
    """Effect file to write (.py); a second law's is beside it."""

    def answer(self, doing: Doing = SILENT) -> Laws:
        """The laws that were learnt, and the effect files drafted of them. Raises BadInput, SolverError."""
        library = self.library(doing)
        draft = None if self.draft is None else free_place(Path(self.draft), set(library))
        saved, dataset = self.saved(), self.traces("learn a curve")
        from needle_rig.workbench.learning import learn_law
        from needle_rig.workbench.learning.observations import Traces

        present = saved.model if saved else None
        with doing.work(self) as work:
            found = learn_law.laws_of(Traces(dataset), library, present, work=work, say=doing.say)
        return Laws(found, found.write_drafts(draft) if draft is not None else ())


def free_place(draft: Path, taken: set[str]) -> Path:
    """The place of a new effect file. Raises BadInput where none can be, or its name is that of an effect."""
    if not draft.absolute().parent.is_dir():
        raise BadInput(f"{draft}: there is no folder {draft.parent}; make it, or name another place")
    if draft.suffix != ".py" or not draft.stem.isidentifier() or draft.stem.startswith("_"):
        raise BadInput(f"{draft}: an effect's file is a Python file; name it as found.py")
    if draft.stem in taken:
        raise BadInput(f"{draft}: there is an effect {draft.stem} already; name the file otherwise")
    return draft
