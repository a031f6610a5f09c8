"""A folder of recordings: which of its files belong together, and which are left aside."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput
from needle_rig.importing import names
from needle_rig.importing.mapping import ClockPart, FilePart, Mapping
from needle_rig.importing.reader import Recordings
from needle_rig.importing.recording import Recording

MAPPING = "import.yaml"
"""In the folder: what was said of its recordings once."""
NO_RECORDINGS = (".yaml", ".yml", ".png", ".md", ".pdf", ".py", ".m", ".dbc")


@dataclass(frozen=True)
class Campaign:
    """The recordings of a folder, in the order of their names, and a sentence for each file left aside."""

    files: tuple[Path, ...]
    left: tuple[str, ...] = ()


def is_campaign(path: Path) -> bool:
    """Whether a path is a folder of recordings; a ROS 2 bag is a folder too, but one recording."""
    return path.is_dir() and not (path / "metadata.yaml").is_file()


def campaign_in(folder: Path, recordings: Recordings, dbc: Path | None = None) -> Campaign:
    """The recordings in `folder` and below. Kinds with fewer files than another do not pair, so are left.

    Raises BadInput when there is none.
    """
    kinds: dict[tuple[tuple[str, str], ...], list[Path]] = {}
    left = []
    for path in _candidates(folder):
        try:
            recording = recordings.read(path, dbc)
        except BadInput as error:
            left.append(f"left aside: {error}")
            continue
        kinds.setdefault(tuple((c.table, c.name) for c in recording.columns), []).append(path)
    if not kinds:
        raise BadInput("\n".join([*left, f"{show_path(folder)}: holds no recording; name another folder"]))
    most, total = max(map(len, kinds.values())), sum(map(len, kinds.values()))
    for paths in kinds.values():
        if len(paths) < most:
            left += [
                f"left aside: {show_path(p)}: {len(paths)} of {total} files have its columns; import it alone"
                for p in paths
            ]
    files = [path for paths in kinds.values() if len(paths) == most for path in paths]
    return Campaign(tuple(files), tuple(left))


def _candidates(folder: Path) -> list[Path]:
    """Files that may be recordings, by their names, numbers in which count as such; no dataset's."""
    found: list[Path] = []
    try:
        entries = sorted(folder.iterdir(), key=lambda p: (names.numbers_in(p.name), p.name))
    except OSError as error:
        raise BadInput(f"{show_path(folder)}: cannot be read: {error.strerror}; check its rights") from None
    for entry in entries:
        if entry.name.startswith(".") or entry.suffix.lower() in NO_RECORDINGS:
            continue
        if is_campaign(entry):
            if not (entry.is_symlink() or (entry / "dataset.yaml").exists()):  # a link may lead round
                found += _candidates(entry)
        else:
            found.append(entry)
    return found


def with_files(mapping: Mapping, recordings: Sequence[Recording], folder: Path) -> Mapping:
    """The mapping with `recordings` in the place of its own, each at the clock whose columns it has.

    Raises BadInput for one that no clock fits.
    """
    wanted = {
        name: {c.source for c in mapping.channels if c.clock == name}
        | ({clock.source} if clock.source else set())
        for name, clock in mapping.clocks.items()
    }
    files: dict[str, list[FilePart]] = {name: [] for name in mapping.clocks}
    for recording in (part for whole in recordings for part in whole.repeats()):
        there = {c.name for c in recording.columns}
        fits = [name for name, sources in wanted.items() if sources <= there]
        if not fits:
            lacking = min((sources - there for sources in wanted.values()), key=len)
            told = ", ".join(sorted(lacking))
            raise BadInput(
                f"{show_path(recording.path)}: has no column {told}, which the mapping names; import it alone"
            )
        for name in fits:
            files[name].append(FilePart(path=os.path.relpath(recording.path, folder), table=recording.table))
    clocks: dict[str, ClockPart] = {
        name: clock.model_copy(update={"files": tuple(files[name])}) for name, clock in mapping.clocks.items()
    }
    counts = {name: len(parts) for name, parts in files.items()}
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{name}: {count}" for name, count in counts.items())
        raise BadInput(f"files of different kinds do not pair ({told}); add the missing ones")
    return mapping.model_copy(update={"clocks": clocks})
