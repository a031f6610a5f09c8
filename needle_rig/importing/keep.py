"""An imported dataset in its folder, with the mapping that makes it again."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from needle_rig.dataset import Dataset, read_dataset, write_dataset
from needle_rig.importing.mapping import Mapping, write_mapping

MAPPING = "import.yaml"


@contextmanager
def kept(dataset: Dataset, mapping: Mapping, folder: Path, out: Path) -> Iterator[list[str]]:
    """Write `dataset` and its `mapping`, with files relative to `folder`, to the new folder `out`.

    Gives a sentence for each trial that a reader leaves out. What cannot be read back, or fails inside the
    with block, is removed. Raises BadInput.
    """
    try:
        write_dataset(dataset, out)
        left_out = [note for note in read_dataset(out).notes if "left out" in note]
        write_mapping(mapping, out / MAPPING, folder)
        yield left_out
    except BaseException:
        shutil.rmtree(out, ignore_errors=True)
        raise
