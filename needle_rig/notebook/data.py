"""Measurements in degrees and N·mm: datasets, their trials, and published settled values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.dataset.settled import SettledData
from needle_rig.errors import BadInput
from needle_rig.notebook.shown import Shown
from needle_rig.notebook.tables import Table, columns_of, or_nan, stacked, table_of
from needle_rig.units import deg, nmm

if TYPE_CHECKING:
    from needle_rig.figures.page import Figure


@dataclass(frozen=True, repr=False)
class Trial(Shown):
    """One trial of a dataset."""

    given: DatasetTrial
    sensor_names: tuple[str, ...]

    @property
    def name(self) -> str:
        """Its file without the ending."""
        return Path(self.given.file).stem

    def __len__(self) -> int:
        return len(self.given.trial.time_s)

    def headline(self) -> str:
        """Its name, command and size."""
        told = ", ".join(f"{key} {value}" for key, value in self.given.command.file_keys().items())
        return f"{self.name}: {told}; {len(self)} samples"

    def table(self) -> Table:
        """A row a sample, in degrees and N·mm; NaN where nothing was read."""
        given = self.given
        size = len(self)
        return columns_of(
            {
                "trial": np.full(size, self.name),
                "time_s": given.trial.time_s,
                "motion": np.asarray(given.phase, dtype=str),
                "base_deg": deg(given.base_measured_rad),
                "torque_nmm": nmm(given.torque_nm),
                **{
                    f"{name}_deg": deg(given.hall_rad[:, place])
                    for place, name in enumerate(self.sensor_names)
                },
            }
        )

    def plot(self) -> Figure:
        """Base angle, torque and Hall angles over time."""
        from needle_rig.figures.dataset import trial_figure

        return trial_figure(self.given, self.sensor_names)


@dataclass(frozen=True, repr=False)
class Data(Shown):
    """A dataset of trials, or published settled values, as a question takes it."""

    given: Dataset | SettledData

    @property
    def name(self) -> str:
        """As a person called it."""
        return self.given.name

    @property
    def notes(self) -> tuple[str, ...]:
        """What was found wrong with the files, and how it was handled."""
        return self.given.notes if isinstance(self.given, Dataset) else ()

    @property
    def trials(self) -> tuple[Trial, ...]:
        """In the order in which they were made. Raises BadInput for settled values, which have none."""
        if not isinstance(self.given, Dataset):
            raise BadInput(f"{self.name} has settled values only, no trials; look at its table")
        return tuple(Trial(trial, self.given.sensor_names) for trial in self.given.trials)

    def __len__(self) -> int:
        return len(self.given.trials if isinstance(self.given, Dataset) else self.given.values)

    def __iter__(self) -> Iterator[Trial]:
        return iter(self.trials)

    def __getitem__(self, place: int) -> Trial:
        return self.trials[place]

    def headline(self) -> str:
        """Its name and size."""
        if isinstance(self.given, SettledData):
            sequences = len(self.given.sequences)
            return f"{self.name}: {len(self)} settled values of {sequences} sequences, {self.given.source}"
        samples = sum(len(trial.trial.time_s) for trial in self.given.trials)
        how = ", simulated" if self.given.simulated else ""
        return f"{self.name}: {len(self)} trials, {samples} samples{how}"

    def table(self) -> Table:
        """A row a sample of every trial, or a row a settled value, in degrees and N·mm."""
        if isinstance(self.given, Dataset):
            return stacked(trial.table() for trial in self)
        return table_of(
            {
                "value_of": self.given.words(value.of),
                "value": value.value,
                "standard_error": or_nan(value.standard_error),
                "unit": value.of.unit,
            }
            for value in self.given.values
        )

    def _overview(self) -> Table:
        if not isinstance(self.given, Dataset):
            return self.table()
        return table_of(
            {
                "trial": trial.name,
                "samples": float(len(trial)),
                "duration_s": float(np.ptp(trial.given.trial.time_s)),
                "kind": trial.given.command.kind,
                "target_deg": or_nan(trial.given.command.target_deg),
                "speed_deg_s": or_nan(trial.given.command.speed_deg_s),
            }
            for trial in self
        )

    def plot(self) -> Figure:
        """Torque and the last sensor's angle over the base angle, a line a trial."""
        from needle_rig.figures.dataset import dataset_figure

        if not isinstance(self.given, Dataset):
            raise BadInput(f"{self.name} has settled values only, no traces to draw; look at its table")
        return dataset_figure(self.given)
