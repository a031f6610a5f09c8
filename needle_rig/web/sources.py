"""What the page may read: folders of data that the command line named, uploads, and the recorded runs.

A browser names keys; which path a key stands for is known here alone.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from needle_rig.dataset.settled import shipped_datasets
from needle_rig.errors import BadInput
from needle_rig.recording import RunSummary, list_runs
from needle_rig.web.uploads import Uploads, data_in

NOTES_SUFFIX = ".notes.json"
NOTES_BYTES = 64 << 10
FOUND = 200
"""Datasets below the folders, at most."""

Document = dict[str, Any]


class Notes(BaseModel):
    """What people add to a run, in a file beside it; the run itself stays as it is."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    tags: Annotated[list[Annotated[str, Field(min_length=1, max_length=40)]], Field(max_length=20)] = []
    note: Annotated[str, Field(max_length=4000)] = ""


@dataclass(frozen=True)
class Source:
    """Data that a job can be given."""

    key: str
    name: str
    kind: str
    """dataset, run, upload or published."""
    paths: tuple[Path, ...]


class Sources:
    """All that the page may read."""

    def __init__(self, data: Sequence[Path], runs: Path, uploads: Uploads) -> None:
        self._data, self._runs, self._uploads = tuple(data), runs, uploads
        self.imported: dict[str, Path] = {}
        """Datasets that were made of dropped recordings, by key."""

    def datasets(self) -> list[Source]:
        """The datasets below the folders of the command line, then those that are shipped."""
        found: list[Source] = []
        for k, root in enumerate(self._data):
            paths = [root] if root.is_file() else data_in(root)
            for path in paths[:FOUND]:
                inner = "" if path == root else path.relative_to(root).as_posix()
                name = f"{root.resolve().name}/{inner}" if inner else root.resolve().name
                found.append(
                    Source(f"data:{k}:{inner}", name, "run" if path.is_file() else "dataset", (path,))
                )
        return found + [
            Source(f"shipped:{name}", name, "published", (path,)) for name, path in shipped_datasets().items()
        ]

    def runs(self) -> list[RunSummary]:
        """The recorded runs, newest first."""
        return list_runs(self._runs)[::-1]

    def run(self, name: str) -> RunSummary:
        """One recorded run by its listed name; raises BadInput."""
        for run in self.runs():
            if run.name == name:
                return run
        raise BadInput(f"{name[:80]}: no such run in the list; it may have been removed")

    def paths(self, keys: Sequence[str]) -> list[str]:
        """What the keys of a request stand for; raises BadInput."""
        if not keys:
            raise BadInput("no data was chosen; choose a dataset, or runs")
        listed = {source.key: source for source in self.datasets()}
        found: list[str] = []
        for key in keys:
            kind, _, rest = key.partition(":")
            if key in listed:
                found += [str(path) for path in listed[key].paths]
            elif key in self.imported:
                if not self.imported[key].is_dir():
                    raise BadInput("this import did not end; import the recordings again")
                found.append(str(self.imported[key]))
            elif kind == "run":
                found.append(str(self.run(rest).path))
            elif kind == "upload":
                upload = self._uploads.get(rest)
                inside = data_in(upload.folder)
                if not inside:
                    raise BadInput(f"{upload.name}: holds no dataset.yaml, settled.yaml or run file")
                found += [str(path) for path in inside]
            else:
                raise BadInput(f"{key[:80]}: no such data; choose from the list")
        return found

    def run_document(self, run: RunSummary) -> Document:
        """A run as the page lists it, with what people added."""
        notes = self.notes(run.name)
        return {
            "name": run.name,
            "simulated": run.simulated,
            "started_utc": run.started_utc,
            "target_deg": None if math.isnan(run.target_deg) else run.target_deg,
            "strategy": run.strategy,
            "parameters": run.parameters,
            "status": run.status,
            "duration_s": round(run.duration_s, 1),
            "tags": notes.tags,
            "note": notes.note,
        }

    def notes(self, name: str) -> Notes:
        """Tags and note of a run; none where there are none, or where their file is damaged."""
        path = self._notes_path(name)
        try:
            if os.path.getsize(path) > NOTES_BYTES:
                return Notes()
            return Notes.model_validate_json(path.read_bytes())
        except (OSError, ValidationError):
            return Notes()

    def keep_notes(self, name: str, content: bytes) -> Notes:
        """Write tags and note beside the run, whole or not at all. Raises BadInput."""
        self.run(name)
        try:
            notes = Notes.model_validate_json(content)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in first["loc"]) or "the note"
            raise BadInput(
                f"{place}: {first['msg'].lower()}; write up to 20 tags of 40 letters, a note of 4000"
            ) from None
        path = self._notes_path(name)
        new = path.with_suffix(".new")
        new.write_text(json.dumps(notes.model_dump(), ensure_ascii=False) + "\n", encoding="utf-8")
        os.replace(new, path)
        return notes

    def _notes_path(self, name: str) -> Path:
        if Path(name).name != name:
            raise BadInput(f"{name[:80]}: is no name of a run")
        return self._runs / f"{name}{NOTES_SUFFIX}"
