"""What the page may read: folders of data that the command line named, uploads, and the recorded runs.

A browser names keys; which path a key stands for is known here alone.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from needle_rig.dataset.settled import shipped_datasets
from needle_rig.errors import BadInput
from needle_rig.recording import being_written, is_run_file, journal_path
from needle_rig.web.run_index import RunIndex, read_document
from needle_rig.web.uploads import Uploads, data_in

NOTES_SUFFIX = ".notes.json"
NOTES_BYTES = 64 << 10
NOTE_LETTERS = 4000
RUNS_SHOWN = 100
"""Runs of one answer."""
FOUND = 200
"""Datasets below the folders, at most."""

Document = dict[str, Any]


class Notes(BaseModel):
    """What people add to a run, in a file beside it; the run itself stays as it is."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    tags: Annotated[list[Annotated[str, Field(min_length=1, max_length=40)]], Field(max_length=20)] = []
    note: Annotated[str, Field(max_length=NOTE_LETTERS)] = ""


def free_name(name: str, taken: set[str]) -> str:
    """The name, or that with a number, which none of `taken` has; it is taken then."""
    found = next(n for k in range(1, len(taken) + 2) if (n := name if k == 1 else f"{name} {k}") not in taken)
    taken.add(found)
    return found


@dataclass(frozen=True)
class Listed:
    """Which of the runs are shown, and in which order."""

    filter: str = ""
    by: str = "started_utc"
    down: bool = True
    start: int = 0


def _text(document: Document) -> str:
    told = [document[name] for name in ("name", "status", "strategy", "parameters", "note")]
    return " ".join([*told, *document["tags"]]).lower()


def _sorted_by(document: Document, by: str) -> tuple[bool, Any, str]:
    value = document.get(by)
    value = ", ".join(value) if isinstance(value, list) else value
    return (value is not None, 0 if value is None else value, document["name"])


@dataclass(frozen=True)
class Source:
    """Data that a job can be given."""

    key: str
    name: str
    kind: str
    """dataset, run, upload, recording, imported or published."""
    paths: tuple[Path, ...]


class Sources:
    """All that the page may read."""

    def __init__(self, data: Sequence[Path], runs: Path, uploads: Uploads, index: RunIndex) -> None:
        self._data, self.runs, self.uploads, self.index = tuple(data), runs, uploads, index
        self.imported: dict[str, Path] = {}
        """Datasets that were made of dropped recordings, by key."""
        self._writing = threading.Lock()

    def datasets(self) -> list[Source]:
        """The datasets below the folders of the command line, then those that are shipped."""
        found: list[Source] = []
        taken: set[str] = set()
        for root in self._data:
            paths = [root] if root.is_file() else data_in(root)
            for path in paths[:FOUND]:
                inner = "" if path == root else path.relative_to(root).as_posix()
                stem = f"{root.resolve().name}/{inner}" if inner else root.resolve().name
                name = free_name(stem, taken)
                kind = "run" if path.is_file() else "dataset"
                found.append(Source(f"data:{name}", name, kind, (path,)))
        for name, path in shipped_datasets().items():
            found.append(Source(f"shipped:{name}", free_name(name, taken), "published", (path,)))
        return found

    def named(self) -> list[Source]:
        """The datasets, and what was dropped, each name once."""
        found = self.datasets()
        taken = {source.name for source in found}
        for key, upload in self.uploads.all().items():
            if upload.files and upload.kind != "model":
                name = free_name(upload.name, taken)
                found.append(Source(f"upload:{key}", name, upload.kind, (upload.folder,)))
        return found

    def run(self, name: str) -> Path:
        """Where the recorded run of this name lies; raises BadInput."""
        path = self.runs / f"{name}.h5"
        if not name or name.startswith(".") or Path(name).name != name or not is_run_file(str(path)):
            raise BadInput(f"{name[:80]}: no such run in the list; it may have been removed")
        return path

    def remove_run(self, name: str) -> None:
        """Remove a recorded run with what people added. Raises BadInput for one that is still written."""
        path = self.run(name)
        if being_written(path):
            raise BadInput(f"{name}: is being recorded; wait for its end, or stop it")
        try:
            for file in (path, journal_path(path), path.with_suffix(".png"), self._notes_path(name)):
                file.unlink(missing_ok=True)
        except OSError as error:
            raise BadInput(
                f"{name}: cannot be removed ({error.strerror}); its folder belongs to another user"
            ) from None

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
                found.append(str(self.run(rest)))
            elif kind == "upload":
                upload = self.uploads.get(rest)
                inside = data_in(upload.folder)
                if not inside:
                    raise BadInput(f"{upload.name}: holds no dataset.yaml, settled.yaml or run file")
                found += [str(path) for path in inside]
            else:
                raise BadInput(f"{key[:80]}: no such data; choose from the list")
        return found

    def run_document(self, name: str) -> Document:
        """One recorded run, with what people added. Raises BadInput."""
        return read_document(self.run(name)) | self.notes(name).model_dump()

    def run_documents(self, asked: Listed) -> Document:
        """Some of the recorded runs, with what people added; how many there are, and are to be read."""
        documents, indexing = self.index.documents(self.runs)
        noted = {path.name for path in self.runs.glob(f"*{NOTES_SUFFIX}")}
        without = Notes().model_dump()
        documents = [
            one | (self.notes(name).model_dump() if f"{name}{NOTES_SUFFIX}" in noted else without)
            for one in documents
            if (name := one["name"])
        ]
        words = asked.filter.lower().split()
        if words:
            documents = [one for one in documents if all(word in _text(one) for word in words)]
        documents.sort(key=lambda one: _sorted_by(one, asked.by), reverse=asked.down)
        shown = documents[asked.start : asked.start + RUNS_SHOWN]
        return {"runs": shown, "of": len(documents), "indexing": indexing}

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
        """Write the tags or the note that changed beside the run, whole or not at all. Raises BadInput."""
        self.run(name)
        try:
            changed = Notes.model_validate_json(content)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in first["loc"]) or "the note"
            raise BadInput(
                f"{place}: {first['msg'].lower()}; write up to 20 tags of 40 letters, a note of 4000"
            ) from None
        path = self._notes_path(name)
        new = path.with_suffix(".new")
        with self._writing:  # what another tab wrote of the other field stays
            notes = self.notes(name).model_copy(update=changed.model_dump(exclude_unset=True))
            try:
                new.write_text(json.dumps(notes.model_dump(), ensure_ascii=False) + "\n", encoding="utf-8")
                os.replace(new, path)
            except OSError as error:
                raise BadInput(
                    f"the note cannot be written ({error.strerror}); nothing was changed"
                ) from None
        return notes

    def _notes_path(self, name: str) -> Path:
        if Path(name).name != name:
            raise BadInput(f"{name[:80]}: is no name of a run")
        return self.runs / f"{name}{NOTES_SUFFIX}"
