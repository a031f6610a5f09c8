"""Where configuration files are: the working folder's config/ first, then what the package ships."""

from __future__ import annotations

import os
from pathlib import Path

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput


def config_directories() -> tuple[Path, ...]:
    """Folders to search, nearest first: ./config, then the files that came with needle-rig."""
    package = Path(__file__).resolve().parent.parent
    shipped = package / "shipped"
    source = package.parent / "config"
    folders = [Path("config"), shipped if shipped.is_dir() else source]
    return tuple(dict.fromkeys(f.resolve() for f in folders if f.is_dir()))


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
