"""What a person names as DATA: folders and names of datasets, run files of the daemon, settled values."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from needle_rig.dataset import Dataset, read_dataset
from needle_rig.dataset.reader import joined
from needle_rig.dataset.settled import SettledData, is_settled, read_settled, shipped_datasets
from needle_rig.errors import BadInput
from needle_rig.recording import RunFile
from needle_rig.workbench.observations.runs import runs_as_dataset

RUN_SUFFIXES = (".h5", ".hdf5")

Paths = Sequence[str | os.PathLike[str]]


def read_observed(paths: Paths) -> Dataset | SettledData:
    """Settled values where one path names them, otherwise traces. Raises BadInput for both at once."""
    found = located(paths)
    settled = [path for path in found if is_settled(path)]
    if settled and len(found) > 1:
        raise BadInput(f"{settled[0]} holds settled values; give it alone")
    return read_settled(settled[0]) if settled else read_measurements(found)


def read_measurements(paths: Paths) -> Dataset:
    """The trials of dataset folders and run files of one rig, folders first. Raises BadInput."""
    if not paths:
        raise BadInput("no data was named; give dataset folders or run files")
    found = located(paths)
    runs = [path for path in found if path.suffix.lower() in RUN_SUFFIXES]
    folders = [path for path in found if path.suffix.lower() not in RUN_SUFFIXES]
    parts = [read_dataset(folder) for folder in folders]
    if runs:
        parts.append(runs_as_dataset([RunFile(path) for path in runs]))
    return parts[0] if len(parts) == 1 else joined(parts)


def located(paths: Paths) -> list[Path]:
    """The paths; those that do not exist are looked for by name among the datasets of config/datasets."""
    known = {} if all(os.path.lexists(path) for path in paths) else shipped_datasets()
    return [Path(path) if os.path.lexists(path) else known.get(str(path), Path(path)) for path in paths]
