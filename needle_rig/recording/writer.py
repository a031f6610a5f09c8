"""Writes a run: an HDF5 file in single-writer-multiple-reader mode, whole after every flush."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
import numpy.typing as npt
from numpy.lib.recfunctions import unstructured_to_structured

from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.recording.tables import EVENT, FORMAT

LIBRARY_VERSION = ("v110", "v110")
CHUNK_BYTES = 65_536


class RunWriter:
    """One run being written.

    The file appears under its name once it can be read; from then on a killed process loses only the rows
    since the last flush. Rows wait at most `flush_interval_s` as long as rows keep coming; call `flush`
    when they pause.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        attributes: Mapping[str, Any],
        tables: Mapping[str, npt.DTypeLike],
        *,
        flush_interval_s: float = 0.25,
    ) -> None:
        """Create the file at `path`, which must not exist yet; BadInput when it does or cannot be made."""
        self.path = Path(path)
        self.flush_interval_s = flush_interval_s
        self.rows = 0
        part = self.path.with_name(f".{self.path.name}.part")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            os.close(os.open(self.path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644))
        except FileExistsError:
            raise BadInput(
                f"{self.path}: exists already; a run is never written over, name another"
            ) from None
        except OSError as error:
            raise BadInput(
                f"{self.path}: cannot be created: {error.strerror}; choose another folder"
            ) from None
        try:
            self._file = _create(part, attributes, tables)
            os.replace(part, self.path)
        except BaseException:
            self.path.unlink(missing_ok=True)
            part.unlink(missing_ok=True)
            raise
        self._pending: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in (*tables, "events")}
        self._flushed_s = time.monotonic()
        self._closed = False

    def append(self, table: str, rows: npt.NDArray[Any] | Sequence[Sequence[Any]]) -> None:
        """Add rows to `table`: an array of its type, tuples of its fields, or flat tuples of numbers."""
        dtype = self._file[table].dtype
        if not (isinstance(rows, np.ndarray) and rows.dtype == dtype):
            rows = _structured(rows, dtype)
        if rows.size:
            self._pending[table].append(rows.reshape(-1))
            self.rows += rows.size
        if time.monotonic() - self._flushed_s >= self.flush_interval_s:
            self.flush()

    def event(self, time_s: float, kind: str, text: str = "") -> None:
        """Add an event; `kind` is one short word, `text` may be long. On disk at once."""
        self._pending["events"].append(_event_rows(time_s, kind, text))
        self.flush()

    def flush(self) -> None:
        """Write every waiting row to the file. Raises NeedleRigError when the disk refuses."""
        self._flushed_s = time.monotonic()
        try:
            for name, waiting in self._pending.items():
                if waiting:
                    rows = np.concatenate(waiting)
                    waiting.clear()
                    _extend(self._file[name], rows)
        except (OSError, RuntimeError) as error:
            raise NeedleRigError(
                f"{self.path}: the run cannot be written: {error}; what came before is safe, free some space"
            ) from None

    def set_attribute(self, name: str, value: Any) -> None:
        """Say more of the run than was known at its start, such as its `result`; `value` is plain JSON data.

        Kept beside the HDF5 attributes, which cannot be added to while others may read; RunFile joins both.
        """
        line = json.dumps({name: value}, ensure_ascii=False).encode() + b"\n"
        _extend(self._file["late_attributes"], np.frombuffer(line, dtype="u1"))

    def close(self, result: Mapping[str, Any] | None = None, *, time_s: float | None = None) -> None:
        """Write what is left, the result and the mark of a complete run; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        try:
            if result is not None:
                self.set_attribute("result", dict(result))
            self.event(time.monotonic() if time_s is None else time_s, "end")
        finally:
            with contextlib.suppress(OSError, RuntimeError):
                self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def new_run(
    directory: str | os.PathLike[str],
    attributes: Mapping[str, Any],
    tables: Mapping[str, npt.DTypeLike],
    *,
    flush_interval_s: float = 0.25,
) -> RunWriter:
    """A writer for a new file in `directory`, named by UTC time and `attributes["strategy"]`."""
    strategy = re.sub(r"[^A-Za-z0-9_-]+", "-", str(attributes.get("strategy", "run"))).strip("-") or "run"
    stem = f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d_%H-%M-%S}Z_{strategy}"
    for attempt in range(1, 1000):
        path = Path(directory) / (f"{stem}.h5" if attempt == 1 else f"{stem}_{attempt}.h5")
        if not path.exists():
            try:
                return RunWriter(path, attributes, tables, flush_interval_s=flush_interval_s)
            except BadInput:
                if not path.exists():
                    raise
    raise BadInput(f"{Path(directory) / stem}.h5: a thousand runs began in this second; wait for the next")


def _create(path: Path, attributes: Mapping[str, Any], tables: Mapping[str, npt.DTypeLike]) -> h5py.File:
    # In SWMR mode nothing can be created any more: no dataset, no attribute.
    file = h5py.File(path, "w", libver=LIBRARY_VERSION)
    file.attrs["format"] = FORMAT
    for name, value in attributes.items():
        file.attrs[name] = value
    for name, dtype in {**tables, "events": EVENT, "late_attributes": np.dtype("u1")}.items():
        kind = np.dtype(dtype)
        rows = max(1, CHUNK_BYTES // kind.itemsize)
        file.create_dataset(name, shape=(0,), maxshape=(None,), chunks=(rows,), dtype=kind)
    file.swmr_mode = True
    file.flush()
    return file


def _extend(dataset: h5py.Dataset, rows: npt.NDArray[Any]) -> None:
    before = dataset.shape[0]
    dataset.resize((before + len(rows),))
    dataset[before:] = rows
    dataset.flush()


def _structured(rows: Sequence[Sequence[Any]] | npt.NDArray[Any], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    if len(rows) == 0:
        return np.empty(0, dtype)
    if not isinstance(rows, np.ndarray) and len(rows[0]) == len(dtype.names or ()):
        return np.array([tuple(row) for row in rows], dtype=dtype)
    return unstructured_to_structured(np.asarray(rows, dtype="f8"), dtype)


def _event_rows(time_s: float, kind: str, text: str) -> npt.NDArray[Any]:
    raw, width = text.encode(), EVENT["text"].itemsize
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
