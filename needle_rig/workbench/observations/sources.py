"""What a person names as DATA: dataset folders, run files of the daemon, or several of both."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from needle_rig.dataset import Dataset, read_dataset
from needle_rig.dataset.reader import joined
from needle_rig.errors import BadInput
from needle_rig.recording import RunFile
from needle_rig.workbench.observations.runs import runs_as_dataset

RUN_SUFFIXES = (".h5", ".hdf5")


def read_measurements(paths: Sequence[str | os.PathLike[str]]) -> Dataset:
    """The trials of dataset folders and run files of one rig, folders first. Raises BadInput."""
    if not paths:
        raise BadInput("no data was named; give dataset folders or run files")
    runs = [Path(p) for p in paths if Path(p).suffix.lower() in RUN_SUFFIXES]
    folders = [Path(p) for p in paths if Path(p).suffix.lower() not in RUN_SUFFIXES]
    parts = [read_dataset(folder) for folder in folders]
    if runs:
        parts.append(runs_as_dataset([RunFile(path) for path in runs]))
    return parts[0] if len(parts) == 1 else joined(parts)
