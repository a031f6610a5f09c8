"""Recordings of any laboratory: what is what in them, and the dataset that they make."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from needle_rig.errors import BadInput
from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.fields import Within
from needle_rig.questions.question import PathLike, Request

if TYPE_CHECKING:
    from needle_rig.dataset import Dataset
    from needle_rig.importing import Mapping, Recordings


@dataclass(frozen=True, slots=True)
class Imported:
    """A dataset that was written."""

    dataset: Dataset
    notes: tuple[str, ...]
    """What was made of the recordings, and each trial that is left out."""


@dataclass(frozen=True, slots=True)
class Understood:
    """A mapping of recordings, which name their files relative to `folder`."""

    mapping: Mapping
    folder: Path
    given: bool
    """A mapping file said it; else the recordings themselves."""
    recordings: Recordings = field(repr=False)
    left: tuple[str, ...] = ()
    """A sentence for each file of a folder that is left aside."""

    def lacks(self) -> list[str]:
        """What has to be said first, a sentence each."""
        return self.mapping.lacks()

    def doubts(self) -> list[str]:
        """What a person has to confirm, a sentence each."""
        return self.mapping.doubts()

    def confirmed(self) -> Understood:
        """The same without doubts."""
        return replace(self, mapping=self.mapping.confirmed())

    @contextmanager
    def written(self, out: Path) -> Iterator[Imported]:
        """The dataset in the new folder `out`; it goes again when the with block fails. Raises BadInput."""
        from needle_rig.importing import dataset_of
        from needle_rig.importing.keep import kept

        dataset = dataset_of(self.mapping, self.folder, recordings=self.recordings)
        with kept(dataset, self.mapping, self.folder, out) as left_out:
            yield Imported(dataset, (*dataset.notes, *left_out))


@dataclass(frozen=True, slots=True, kw_only=True)
class Understand(Request):
    """Say what is what in recordings: as a mapping among them says, or as they say themselves."""

    files: Sequence[PathLike]
    name: str
    """Of the dataset that is to be."""
    folder: PathLike = ""
    """That the files are in."""
    layout: PathLike | None = None
    """File with the shaft, which takes the place of a mapping's own."""
    dbc: PathLike | None = None
    """Database of the CAN bus, of logs of which is read; without it this rig's own, or a mapping's."""
    machine: str | None = None
    """Kind of machine, whose layout is written where none is given."""
    lever_mm: Annotated[float, Within(1e-3, 1e5)] | None = None
    """Radius at which what slides turns."""

    def answer(self, doing: Doing = SILENT) -> Understood:
        """The mapping of the files, guessed or given, and what is to be confirmed. Raises BadInput."""
        from needle_rig.importing import Recordings
        from needle_rig.importing.asked import given_mapping, guessed_mapping, is_mapping
        from needle_rig.importing.campaign import MAPPING, campaign_in, is_campaign
        from needle_rig.physics.machine import machine_called

        root, layout = Path(self.folder), None if self.layout is None else Path(self.layout)
        files = [root / file for file in self.files]
        named = [file for file in files if is_mapping(file)]
        folders = [file for file in files if is_campaign(file)]
        if not named:
            named = [kept for kept in (folder / MAPPING for folder in folders) if os.path.isfile(kept)]
        others = [file for file in files if file not in named and file not in folders]
        if len(named) > 1:
            raise BadInput(f"{os.path.relpath(named[1], root)}: a second mapping; give one")
        if not files:
            raise BadInput("there is no recording; give one, or a mapping")
        dbc = None if self.dbc is None else Path(self.dbc)
        machine = None if self.machine is None else machine_called(self.machine)
        recordings = Recordings()
        left: tuple[str, ...] = ()
        for folder in folders:
            doing.say("reading the folder")
            found = campaign_in(folder, recordings, dbc)
            others += found.files
            left += found.left
        if named:
            doing.say("reading the mapping")
            mapping, folder = given_mapping(named[0], others, layout, recordings, dbc, machine, self.lever_mm)
            return Understood(mapping, folder, True, recordings, left)
        doing.say("reading the recordings")
        mapping = guessed_mapping(others, self.name, layout, recordings, root, dbc, machine, self.lever_mm)
        return Understood(mapping, root, False, recordings, left)
