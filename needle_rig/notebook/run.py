"""A recorded run in degrees and N·mm."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.notebook.data import Data
from needle_rig.notebook.shown import Shown
from needle_rig.notebook.tables import Table, columns_of, table_of
from needle_rig.questions.export import Export, Form
from needle_rig.recording import RunFile
from needle_rig.recording.tables import edge_values
from needle_rig.workbench.observations.runs import runs_as_dataset

if TYPE_CHECKING:
    from needle_rig.figures.page import Figure

EVENTS = "events"


@dataclass(frozen=True, repr=False)
class Run(Shown):
    """A recorded run."""

    file: RunFile

    @property
    def name(self) -> str:
        """Its file without the ending."""
        return self.file.name

    @property
    def tables(self) -> tuple[str, ...]:
        """Names that `table` takes."""
        return *self.file.tables, EVENTS

    def __len__(self) -> int:
        return len(self.file.table("ticks"))

    def headline(self) -> str:
        """Its name and how it ended."""
        result = self.file.result
        return f"{self.file.name}: {'cut off' if result is None else result['status']}"

    def table(self, name: str = "ticks") -> Table:
        """All rows of a table of the run (`ticks`, `torque`, `hall`, `drive`, `events`), as CSV files have
        them.

        Angles are in degrees, torques in N·mm, a column a sensor; `time_s` counts from the run's first row.
        Raises BadInput.
        """
        begin_s = self.file.span_s[0]
        if name == EVENTS:
            return table_of(
                (
                    {"time_s": event.time_s - begin_s, "kind": event.kind, "text": event.text}
                    for event in self.file.events
                ),
                ("time_s", "kind", "text"),
            )
        if name not in self.file.tables:
            raise BadInput(f"{self.name}: has no table {name}; it has {', '.join(self.tables)}")
        columns = {column: values for column, values, _ in edge_values(self.file.table(name), begin_s)}
        return columns_of(
            {
                column: np.char.decode(values, "utf-8", "replace") if values.dtype.kind == "S" else values
                for column, values in columns.items()
            }
        )

    def dataset(self) -> Data:
        """The run as a dataset of one trial."""
        return Data(runs_as_dataset([self.file]))

    def plot(self) -> Figure:
        """Angles and torque over time, and the shaft after each motion."""
        from needle_rig.figures.run import run_figure

        return run_figure(self.file)

    def _overview(self) -> Table:
        """What happened, instead of thousands of ticks."""
        return self.table(EVENTS)

    def export(self, out: str | os.PathLike[str], form: Form = "csv") -> Path:
        """Write the run to `out`, which must be new: a folder of CSV or of a dataset, an MCAP or PNG file.

        Raises BadInput.
        """
        return Export(run=self.file, form=form, out=out).answer()
