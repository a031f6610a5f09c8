"""Writes a run: a journal while it goes on, the HDF5 file of it when it ends."""

from __future__ import annotations

import datetime
import errno
import json
import os
import re
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from numpy.lib.recfunctions import unstructured_to_structured

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.recording.image import LATE, Shape, empty_image, make_run_file
from needle_rig.recording.journal import Journal, is_full, journal_path, refusal, sync_folder
from needle_rig.recording.tables import EVENT, Rows

SYNC_INTERVAL_S = 0.1
"""With the 0.05 s that the daemon collects rows for, a power cut takes less than 0.25 s of a run."""

STRATEGY_LETTERS = 64
"""Far more than any strategy has; a file name bears 255 bytes."""


class RunExists(BadInput):
    """A run of this name is there already."""


class NotWritten(RigFault):
    """A run cannot be written on; its first `kept_rows` rows are kept."""

    def __init__(self, sentence: str, kept_rows: int) -> None:
        super().__init__(sentence)
        self.kept_rows = kept_rows


class RunWriter:
    """One run being written to the journal beside `path`; `close` makes the HDF5 file at `path` of it.

    Rows are with the kernel when `append` returns, so that a kill of this process loses none of them, and on
    the disk `sync_interval_s` later. After an error rows are missing: events, `set_attribute` and `close` go
    on, `append` does not, and the run never counts as complete.
    """

    _syncing: threading.Thread | None = None

    def __init__(
        self,
        path: str | os.PathLike[str],
        attributes: Mapping[str, Any],
        tables: Mapping[str, npt.DTypeLike],
        *,
        sync_interval_s: float = SYNC_INTERVAL_S,
    ) -> None:
        """Begin the run at `path`, where none may be; on the disk when this returns.

        Raises BadInput when one is there, the folder cannot take it or HDF5 cannot hold `attributes`, and
        RigFault when the disk is full.
        """
        self.path = Path(path)
        image = empty_image(attributes, tables)
        _make_folder(self.path.parent)
        try:
            if self.path.exists():
                raise FileExistsError
            journal = Journal.create(journal_path(self.path), image)
        except FileExistsError:
            raise RunExists(
                f"{show_path(self.path)}: exists already; a run is never written over, name another"
            ) from None
        except OSError as error:
            if is_full(error):
                raise RigFault(
                    f"{show_path(self.path)}: cannot be created: {refusal(error)}; free some space"
                ) from None
            raise BadInput(
                f"{show_path(self.path)}: cannot be created: {refusal(error)}; choose another folder"
            ) from None
        self._begin(journal, Shape.of(image))
        self._syncing = threading.Thread(
            target=self._keep_synced, args=(sync_interval_s,), name="sync run", daemon=True
        )
        self._syncing.start()

    @classmethod
    def resume(cls, path: str | os.PathLike[str]) -> Self:
        """Take over the run at `path` that another writer left unfinished, to close it.

        Raises BadInput while it is being written or when there is no journal of it, and RigFault when the
        disk refuses.
        """
        writer = cls.__new__(cls)
        writer.path = Path(path)
        try:
            shape = Shape()
            journal = Journal.reopen(journal_path(writer.path), shape.take)
        except FileNotFoundError:
            raise BadInput(f"{show_path(writer.path)}: there is no unfinished run of this name") from None
        except OSError as error:
            raise RigFault(
                f"{show_path(writer.path)}: the unfinished run cannot be taken over: {refusal(error)}"
            ) from None
        except (ValueError, KeyError, RuntimeError) as error:
            raise BadInput(
                f"{show_path(journal_path(writer.path))}: is no journal of a run: {error}"
            ) from None
        writer._begin(journal, shape)
        return writer

    def _begin(self, journal: Journal, shape: Shape) -> None:
        self._journal = journal
        self._shape = shape
        self._trouble: NeedleRigError | None = None
        self._ended = threading.Event()

    @property
    def rows(self) -> int:
        """How many rows there are, of all tables and the events."""
        return self._shape.rows

    @property
    def torn_bytes(self) -> int:
        """What the writer before left of a frame; it is left out."""
        return self._journal.torn_bytes

    @property
    def last_s(self) -> float:
        """The latest time of a row on the daemon's clock; 0 without any."""
        return self._shape.last_s

    @property
    def complete(self) -> bool:
        """Whether the run has its end, and only its HDF5 file may be missing."""
        return self._shape.ended

    def append(self, table: str, rows: Rows | Sequence[Sequence[Any]]) -> None:
        """Add rows to `table`: an array of its type, tuples of its fields, or flat tuples of numbers.

        Raises RigFault when the disk refuses them or an earlier sync.
        """
        if self._trouble is not None:
            raise self._trouble
        dtype = self._shape.types[table]
        if not (isinstance(rows, np.ndarray) and rows.dtype == dtype):
            rows = _structured(rows, dtype)
        self._add(table, rows)

    def event(self, time_s: float, kind: str, text: str = "") -> None:
        """Add an event; `kind` is one short word, `text` may be long."""
        self._add("events", _event_rows(time_s, kind, text), last_words=True)

    def set_attribute(self, name: str, value: Any) -> None:
        """Say more than was known at the start, such as the `result`; `value` is plain JSON data."""
        line = json.dumps({name: value}).encode() + b"\n"
        self._add(LATE, np.frombuffer(line, dtype="u1"), last_words=True)

    def sync(self) -> None:
        """Wait until every row is on the disk. Raises RigFault when it is not, or the file lost its place."""
        try:
            self._journal.sync()
        except OSError as error:
            self._fail(error)
        except RigFault as fault:
            self._trouble = self._trouble or fault
        if self._trouble is not None:
            raise self._trouble

    def close(self, result: Mapping[str, Any] | None = None, *, time_s: float | None = None) -> None:
        """Write the result and, unless rows are missing, the mark of a complete run; make the HDF5 file.

        `time_s` is the time of the end, by default that of the last row. Safe to call twice. Raises RigFault
        when the disk refuses; what was written stays in the journal, which reads like the file.
        """
        end = ("end", "") if self._trouble is None else ("recorder", str(self._trouble))
        self._finish(result, self.last_s if time_s is None else time_s, *end)

    def close_unfinished(self, text: str, result: Mapping[str, Any] | None = None) -> None:
        """Close a run that was cut off, which `text` says in an event: no mark of a complete run is set."""
        self._finish(result, self.last_s, "recorder", text)

    def _finish(self, result: Mapping[str, Any] | None, time_s: float, kind: str, text: str) -> None:
        if not self._journal.is_open:
            return
        try:
            if not self.complete:
                if result is not None:
                    self.set_attribute("result", dict(result))
                self.event(time_s, kind, text)
            self._stop_syncing()
            self._journal.sync()
            make_run_file(self._journal.path, self.path)
            self._journal.remove()
        except OSError as error:
            raise RigFault(
                f"{show_path(self.path)}: cannot be made: {refusal(error)}; the run is kept in"
                f" {self._journal.path.name} beside it, which reads like it; free some space"
            ) from None
        finally:
            self.leave()

    def discard(self) -> None:
        """Take the run away: it never began."""
        self._stop_syncing()
        self._journal.remove()

    def leave(self) -> None:
        """Let go of the run as it is; `resume` takes it over."""
        self._stop_syncing()
        self._journal.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _add(self, table: str, rows: Rows, *, last_words: bool = False) -> None:
        if not rows.size:
            return
        number, payload = self._shape.number(table), rows.tobytes()
        try:
            self._journal.append(number, payload, last_words=last_words)
        except OSError as error:
            raise self._fail(error) from None
        self._shape.take(number, payload)

    def _fail(self, error: OSError) -> NeedleRigError:
        self._trouble = self._trouble or NotWritten(
            f"{show_path(self.path)}: the run cannot be written: {refusal(error)};"
            f" its first {self.rows} rows are kept; free some space",
            self.rows,
        )
        return self._trouble

    def _stop_syncing(self) -> None:
        self._ended.set()
        if self._syncing is not None:
            self._syncing.join()

    def _keep_synced(self, interval_s: float) -> None:
        while not self._ended.wait(interval_s):
            try:
                self.sync()
            except RigFault:
                return  # told by the next append or question


def new_run(
    directory: str | os.PathLike[str],
    attributes: Mapping[str, Any],
    tables: Mapping[str, npt.DTypeLike],
    *,
    sync_interval_s: float = SYNC_INTERVAL_S,
) -> RunWriter:
    """A writer for a new run in `directory`, named by UTC time and `attributes["strategy"]`.

    Raises as RunWriter does, and BadInput for a strategy of more than 64 letters.
    """
    named = str(attributes.get("strategy", "run"))
    if len(named) > STRATEGY_LETTERS:
        raise BadInput(
            f"strategy: {named[:20]}… has {len(named)} letters, more than {STRATEGY_LETTERS};"
            " list the strategies with: needle-rig strategies"
        )
    strategy = re.sub(r"[^A-Za-z0-9_-]+", "-", named).strip("-") or "run"
    stem = f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d_%H-%M-%S}Z_{strategy}"
    for attempt in range(1, 1000):
        path = Path(directory) / (f"{stem}.h5" if attempt == 1 else f"{stem}_{attempt}.h5")
        try:
            return RunWriter(path, attributes, tables, sync_interval_s=sync_interval_s)
        except RunExists:
            continue
    raise BadInput(f"{Path(directory) / stem}.h5: a thousand runs began in this second; wait for the next")


def _make_folder(folder: Path) -> None:
    try:
        missing = [folder, *folder.parents]
        missing = missing[: next(n for n, one in enumerate(missing) if one.exists())]
        for one in reversed(missing):
            one.mkdir(exist_ok=True)
            sync_folder(one.parent)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "")
    except OSError as error:
        raise BadInput(
            f"{show_path(folder)}: cannot be the folder of the runs: {refusal(error)};"
            " name another in recording.directory of the rig file"
        ) from None


def _structured(rows: Sequence[Sequence[Any]] | Rows, dtype: np.dtype[Any]) -> Rows:
    if len(rows) == 0:
        return np.empty(0, dtype)
    if not isinstance(rows, np.ndarray) and len(rows[0]) == len(dtype.names or ()):
        return np.array([tuple(row) for row in rows], dtype=dtype)
    return unstructured_to_structured(np.asarray(rows, dtype="f8"), dtype)


def _event_rows(time_s: float, kind: str, text: str) -> Rows:
    raw, width = text.encode("utf-8", "replace"), EVENT["text"].itemsize
    pieces: list[bytes] = []
    while raw or not pieces:
        cut = min(len(raw), width)
        while cut < len(raw) and raw[cut] & 0xC0 == 0x80:
            cut -= 1
        pieces.append(raw[:cut])
        raw = raw[cut:]
    return np.array(
        [(time_s, kind.encode() if index == 0 else b"", piece) for index, piece in enumerate(pieces)], EVENT
    )
