"""Finding a configuration file: in the working folder's config/ first, then in what the package ships."""

from __future__ import annotations

import os
from pathlib import Path

from needle_rig.config.directories import config_directories
from needle_rig.config.places import show_path
from needle_rig.errors import BadInput


def shipped_file(name: str) -> Path:
    """The file `name` that came with needle-rig, whatever the working folder has."""
    return config_directories()[-1] / name


def find_config_file(name: str) -> Path:
    """The file `name` ("rig.yaml", "parameters/rig_elastic.yaml") in the nearest folder that has it.

    Raises BadInput, naming the folders searched.
    """
    folders = config_directories()
    for folder in folders:
        if os.path.isfile(folder / name):
            return folder / name
    searched = " and ".join(show_path(f) for f in folders) or "no folder (there is no ./config)"
    raise BadInput(f"{name}: no such file in {searched}; name one with its path")
