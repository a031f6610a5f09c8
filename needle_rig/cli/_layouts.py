"""Layouts by name: the paper's two, a rig file's, a dataset's."""

from __future__ import annotations

import os
from pathlib import Path

from needle_rig.dataset.description import layout_of, read_description
from needle_rig.errors import BadInput
from needle_rig.model import EXPERIMENT_LAYOUT, MODEL_LAYOUT
from needle_rig.physics.rod import Layout


def layout_named(name: str) -> Layout:
    """The layout that `name` stands for: `experiment`, `model`, a rig file or a dataset folder.

    Raises BadInput with file and line.
    """
    if name == "experiment":
        return EXPERIMENT_LAYOUT
    if name == "model":
        return MODEL_LAYOUT
    path = Path(name)
    if os.path.isdir(path):
        description, places = read_description(path)
        return layout_of(description.rig, places)
    if not os.path.lexists(path):
        raise BadInput(f"--layout {name}: is neither experiment nor model, nor a rig file or dataset folder")
    from needle_rig.config.loader import load_rig_config
    from needle_rig.control.in_si import layout_of as layout_of_rig

    return layout_of_rig(load_rig_config(path))
