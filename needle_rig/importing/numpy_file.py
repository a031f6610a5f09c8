"""NumPy's .npy and .npz."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.importing.arrays import Leaf, columns_of
from needle_rig.importing.recording import Read


def read_numpy(path: Path, shown: str) -> Read:
    """Dialect in words, columns and rates. Raises BadInput; objects, which could run code, are not read."""
    try:
        content = np.load(path, allow_pickle=False)
        if isinstance(content, np.ndarray):
            leaves: dict[str, Leaf] = {"array": (content, "")}
        else:
            with content:
                leaves = {name: (content[name], "") for name in content.files}
    except Exception as error:  # noqa: BLE001 - damaged archives raise zipfile's, zlib's and numpy's errors
        raise BadInput(f"{shown}: cannot be read as NumPy's: {str(error)[:200]}; save plain arrays") from None
    columns, rates = columns_of(leaves, shown)
    return "NumPy", columns, rates
