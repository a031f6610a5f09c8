"""The mapping that a person asks for: one that is given, or a guess from the files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from needle_rig.importing.campaign import with_files
from needle_rig.importing.guess import guess
from needle_rig.importing.guess.known import Known
from needle_rig.importing.mapping import LayoutPart, Mapping, read_mapping
from needle_rig.importing.reader import Recordings
from needle_rig.importing.shaft import read_rig
from needle_rig.physics.machine import MachineName


def is_mapping(file: Path) -> bool:
    """Whether a file says what is what in others."""
    return file.suffix.lower() in (".yaml", ".yml") and not file.is_dir()


def given_mapping(
    path: Path,
    others: Sequence[Path],
    layout: Path | None,
    recordings: Recordings,
    dbc: Path | None = None,
    machine: MachineName | None = None,
    lever_mm: float | None = None,
) -> tuple[Mapping, Path]:
    """The mapping in a file, and the folder that its files are relative to; `others` take their place.

    Raises BadInput.
    """
    mapping, _ = read_mapping(path)
    if layout is not None:
        mapping = mapping.model_copy(update={"rig": read_rig(layout), "layout": LayoutPart()})
    if machine is not None or lever_mm is not None:
        rig, told = Known(mapping.rig, machine, lever_mm).layout(mapping.channels)
        mapping = mapping.model_copy(update={"rig": rig, "layout": told})
    if dbc is not None:
        mapping = mapping.model_copy(update={"dbc": os.path.relpath(dbc, path.parent)})
    if others:
        of = mapping.database(path.parent)
        mapping = with_files(mapping, [recordings.read(file, of) for file in others], path.parent)
    return mapping, path.parent


def guessed_mapping(
    files: Sequence[Path],
    name: str,
    layout: Path | None,
    recordings: Recordings,
    root: Path,
    dbc: Path | None = None,
    machine: MachineName | None = None,
    lever_mm: float | None = None,
) -> Mapping:
    """What the files themselves say of their columns, with reasons and doubts; it names them from `root` on.

    `dbc` decodes logs of a CAN bus.

    Raises BadInput.
    """
    rig = None if layout is None else read_rig(layout)
    mapping = guess([recordings.read(file, dbc) for file in files], name, rig, root, machine, lever_mm)
    return mapping if dbc is None else mapping.model_copy(update={"dbc": os.path.relpath(dbc, root)})
