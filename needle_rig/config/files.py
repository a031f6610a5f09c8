"""Finding a configuration file: in the working folder's config/ first, then in what the package ships."""

from __future__ import annotations

import difflib
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


def named_files(kind: str) -> dict[str, Path]:
    """YAML files below `kind` of the config folders by name, the working folder's before the shipped ones."""
    found: dict[str, Path] = {}
    for folder in config_directories():
        for path in sorted((folder / kind).glob("*.yaml")):
            found.setdefault(path.stem, path)
    return found


def parameter_sets() -> dict[str, Path]:
    """Every parameter set by name; see `named_files`."""
    return named_files("parameters")


def parameters_path(name_or_path: str | os.PathLike[str]) -> Path:
    """The file of a set's name, or the path itself. Raises BadInput, listing the sets, when there is none."""
    given = os.fspath(name_or_path)
    if given.endswith((".yaml", ".yml")) or os.sep in given:
        return Path(given)
    sets = parameter_sets()
    if given not in sets:
        near = difflib.get_close_matches(given, sets, n=1, cutoff=0.8)
        meant = f"did you mean {near[0]}? there are" if near else "there are"
        raise BadInput(
            f"there is no parameter set {given}; {meant} {', '.join(sorted(sets)) or 'none'},"
            " or name a model file (ending in .yaml)"
        )
    return sets[given]
