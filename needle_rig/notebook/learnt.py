"""What `learn`, `strategies` and `experiment` answer."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from needle_rig.dataset.protocol import Protocol
from needle_rig.errors import BadInput
from needle_rig.notebook.model import Model
from needle_rig.notebook.shown import Shown
from needle_rig.notebook.tables import Table, or_nan, table_of
from needle_rig.workbench.contest.contest import Contest
from needle_rig.workbench.laws.learnt import Learnt
from needle_rig.workbench.learning.experiment import Experiment as _Proposed

if TYPE_CHECKING:
    from needle_rig.figures.page import Figure


@dataclass(frozen=True, repr=False)
class Laws(Shown):
    """Laws that no library holds, with their curves and formulas."""

    found: Learnt

    @property
    def verdict(self) -> str:
        """`law`, `none`, `library` or `cannot_tell`."""
        return self.found.verdict

    @property
    def library(self) -> tuple[str, ...]:
        """Effects of the library that are named, in place of a law or beside it."""
        return self.found.library

    @property
    def formulas(self) -> tuple[str | None, ...]:
        """The formula of each law; None where its curve has none."""
        return tuple(law.formula for law in self.found.laws)

    def headline(self) -> str:
        """The verdict in a sentence."""
        return f"{self.found.origin.dataset}: {self.verdict.replace('_', ' ')}. {self.found.sentence}"

    def table(self) -> Table:
        """A row a parameter of each law's formula."""
        return table_of(
            (
                {"law": law.law.name, "parameter": name, "value": value, "stderr": spread, "unit": unit}
                for law in self.found.laws
                for name, value, spread, unit in law.parameters
            ),
            ("law", "parameter", "value", "stderr", "unit"),
        )

    def plot(self) -> Figure:
        """The curves over the data that tell them. Raises BadInput where there is no law."""
        from needle_rig.figures.laws import laws_figure

        if not self.found.laws:
            raise BadInput(f"{self.found.origin.dataset}: its verdict is {self.verdict}; there is no curve")
        return laws_figure(self.found)

    def save(self, path: str | os.PathLike[str]) -> tuple[Path, ...]:
        """Write an effect file a law: the first at `path` (.py), others numbered beside it."""
        return self.found.write_drafts(Path(path))


@dataclass(frozen=True, repr=False)
class Strategies(Shown):
    """Every strategy on the same simulated needles."""

    found: Contest
    title: str

    @property
    def model(self) -> Model | None:
        """The model that planned worked with; None where planned did not run."""
        return None if self.found.saved is None else Model(self.found.saved)

    def headline(self) -> str:
        """The rig, and what is predicted of planned."""
        told = self.found.predicted
        return self.title if told is None else f"{self.title}: {told.sentence}"

    def table(self) -> Table:
        """A row a strategy: medians, the worst error also as its 95 % quantile; NaN where it refused."""
        rows = []
        for row in self.found.table.overall():
            worst, lag = row.get("worst_deg"), row.get("tip_lag_deg")
            torque = row.get("torque_nmm")
            rows.append(
                {
                    "strategy": row["strategy"],
                    "worst_deg": or_nan(worst and worst["median"]),
                    "worst_q95_deg": or_nan(worst and worst["q95"]),
                    "tip_lag_deg": or_nan(lag and lag["median"]),
                    "torque_nmm": or_nan(torque and torque["median"]),
                    "rotations": or_nan(row.get("rotations")),
                    "time_s": or_nan(row.get("time_s")),
                }
            )
        return table_of(rows)

    def plot(self) -> Figure:
        """The worst error of every strategy, and what it costs in time."""
        from needle_rig.figures.strategies import strategies_figure

        return strategies_figure(self.found.table, self.title)


@dataclass(frozen=True, repr=False)
class Experiment(Shown):
    """The trials that would tell two effects apart, the best first."""

    found: _Proposed

    @property
    def protocol(self) -> Protocol:
        """The best trial, repeated; `simulate` takes it."""
        return self.found.protocol()

    def headline(self) -> str:
        """The proposal, and what it gives."""
        return " ".join(self.found.sentences())

    def table(self) -> Table:
        """A row a candidate."""
        return table_of(
            {
                "kind": p.command.kind,
                "target_deg": or_nan(p.command.target_deg),
                "speed_deg_s": or_nan(p.command.speed_deg_s),
                "settle_s": or_nan(p.command.settle_s),
                "separation_sigma": p.separation_sigma,
                "duration_s": p.duration_s,
            }
            for p in self.found.ranked
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the protocol file that `compensate --protocol` takes."""
        self.found.save(Path(path))
