"""A recorded run in a format that other programs read, or as a dataset."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from needle_rig.errors import BadInput
from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.question import AnyRun, PathLike, Request

Form: TypeAlias = Literal["csv", "dataset", "mcap", "png"]
ENDINGS: dict[Form, str] = {"csv": "_csv", "dataset": "_dataset", "mcap": ".mcap", "png": ".png"}
"""By format, what follows the run's name in that of the folder or file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Export(Request):
    """Write a run to a new place: a folder of CSV or of a dataset, an MCAP file, or a picture."""

    run: AnyRun
    form: Form = "csv"
    out: PathLike | None = None
    """Folder or file to write; None: named as the run."""
    folder: PathLike = ""
    """That `out` is in."""

    def answer(self, doing: Doing = SILENT) -> Path:
        """What was written; the run counts as read from here on. Raises BadInput."""
        from needle_rig.config.places import show_path
        from needle_rig.recording import RunFile, mark_read

        run = RunFile(self.run) if isinstance(self.run, str | os.PathLike) else self.run
        if not isinstance(run, RunFile):
            raise BadInput(f"run is of type {type(run).__name__}; give a path, or a run")
        target = Path(self.folder) / (self.out or f"{run.name}{ENDINGS[self.form]}")
        doing.say("writing the file")
        if self.form == "csv":
            from needle_rig.recording.export_csv import export_csv

            export_csv(run, target)
        elif self.form == "mcap":
            from needle_rig.recording.export_mcap import export_mcap

            export_mcap(run, target)
        elif self.form == "png":
            if os.path.lexists(target):
                raise BadInput(f"{show_path(target)}: exists already; name another place")
            from needle_rig.figures.run import draw_run

            draw_run(run, target)
        else:
            from needle_rig.dataset import write_dataset
            from needle_rig.workbench.observations.runs import runs_as_dataset

            write_dataset(runs_as_dataset([run]), target)
        mark_read(run.path)
        return target
