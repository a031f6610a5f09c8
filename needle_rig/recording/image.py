"""The HDF5 form of a run: empty before its first row, and filled from the journal."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
import numpy.typing as npt

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput, RigFault
from needle_rig.recording.journal import Frames, sync_folder
from needle_rig.recording.tables import EVENT, FORMAT

LATE = "late_attributes"
LIBRARY_VERSION = ("v110", "v110")
CHUNK_BYTES = 65_536
_BATCH_BYTES = 2**20
_SHOWN_LETTERS = 40


class Shape:
    """What is known of a journal from its frames: the tables, and how far the run came."""

    def __init__(self) -> None:
        self.types: dict[str, np.dtype[Any]] = {}
        self.rows = 0
        self.last_s = 0.0
        self.ended = False
        self._names: list[str] = []

    @classmethod
    def of(cls, image: bytes) -> Self:
        """The shape of a journal that holds its first frame alone."""
        shape = cls()
        shape.take(0, image)
        return shape

    def number(self, table: str) -> int:
        """The number by which frames name `table`; KeyError without one."""
        if table not in self.types:
            raise KeyError(table)
        return self._names.index(table)

    def name(self, table: int, payload: bytes) -> str:
        """The name of the table whose rows a frame holds; ValueError when it fits none."""
        name = self._names[table] if table < len(self._names) else ""
        if not name or len(payload) % self.types[name].itemsize:
            raise ValueError(f"a frame of {len(payload)} bytes fits no table {table}")
        return name

    def take(self, table: int, payload: bytes) -> None:
        """Take one frame into account, the first being the image; ValueError for one that fits no table."""
        if not self._names:
            with _in_memory(payload, writable=False) as file:
                self._names = sorted(file)
                self.types = {name: file[name].dtype for name in self._names}
            return
        name = self.name(table, payload)
        if name != LATE:
            dtype = self.types[name]
            last = np.frombuffer(payload[-dtype.itemsize :], dtype)[0]
            self.rows += len(payload) // dtype.itemsize
            self.last_s = max(self.last_s, float(last["time_s"]))
            self.ended = name == "events" and last["kind"] == b"end"


def empty_image(attributes: Mapping[str, Any], tables: Mapping[str, npt.DTypeLike]) -> bytes:
    """A run file without a row, as bytes. Raises BadInput for an attribute that HDF5 cannot hold."""
    with h5py.File("run", "w", libver=LIBRARY_VERSION, driver="core", backing_store=False) as file:
        file.attrs["format"] = FORMAT
        for name, value in attributes.items():
            try:
                file.attrs[name] = value
            except (TypeError, ValueError, RuntimeError, OSError) as error:
                raise BadInput(
                    f"{name}: {_short(value)} cannot be written to a run file: {_first_line(error)}"
                ) from None
        for name, dtype in {**tables, "events": EVENT, LATE: np.dtype("u1")}.items():
            kind = np.dtype(dtype)
            rows = max(1, CHUNK_BYTES // kind.itemsize)
            file.create_dataset(
                name, shape=(0,), maxshape=(None,), chunks=(rows,), dtype=kind, fletcher32=True
            )
        file.flush()
        return bytes(file.id.get_file_image())


def journal_as_hdf5(path: Path) -> h5py.File:
    """The run in the journal at `path` as an open HDF5 file in memory, up to its last whole frame.

    Raises BadInput when it is no journal or was cut off before it began, and FileNotFoundError.
    """
    frames = iter(Frames(path))
    _, image = next(frames, (0, b""))
    if not image:
        raise BadInput(
            f"{show_path(path)}: holds nothing yet: it begins at this moment, or was cut off before it began"
        )
    file = _in_memory(image, writable=True)
    _fill(file, image, frames)
    return file


def make_run_file(journal: Path, path: Path) -> None:
    """Make the run file at `path` of `journal`; it has its name only when it is whole and on the disk.

    Raises OSError when the disk refuses it.
    """
    frames = iter(Frames(journal))
    _, image = next(frames)
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("wb") as stream:
            stream.write(image)
            # room first: HDF5 ends the process when the disk is full while it closes a file
            room_bytes = journal.stat().st_size + CHUNK_BYTES * (len(Shape.of(image).types) + 1)
            os.posix_fallocate(stream.fileno(), 0, room_bytes + room_bytes // 64)
        with h5py.File(part, "r+", libver=LIBRARY_VERSION) as file:
            _fill(file, image, frames)
        with part.open("rb") as stream:
            os.fsync(stream.fileno())
        os.replace(part, path)
    except RuntimeError as error:
        raise RigFault(f"{show_path(path)}: HDF5 cannot make it: {_first_line(error)}") from None
    finally:
        part.unlink(missing_ok=True)
    sync_folder(path.parent)


def _fill(file: h5py.File, image: bytes, frames: Iterable[tuple[int, bytes]]) -> None:
    shape = Shape.of(image)
    waiting: dict[str, bytearray] = {name: bytearray() for name in shape.types}
    for number, payload in frames:
        name = shape.name(number, payload)
        waiting[name] += payload
        if len(waiting[name]) >= _BATCH_BYTES:
            _extend(file[name], waiting[name])
    for name, rows in waiting.items():
        _extend(file[name], rows)


def _extend(dataset: h5py.Dataset, rows: bytearray) -> None:
    new = np.frombuffer(bytes(rows), dataset.dtype)
    rows.clear()
    if len(new):
        before = dataset.shape[0]
        dataset.resize((before + len(new),))
        dataset[before:] = new


def _in_memory(image: bytes, *, writable: bool) -> h5py.File:
    flags = h5py.h5f.FILE_IMAGE_OPEN_RW if writable else 0
    return h5py.File(h5py.h5f.open_file_image(image, flags=flags))


def _short(value: Any) -> str:
    shown = repr(value)
    return shown if len(shown) <= _SHOWN_LETTERS else f"{shown[:_SHOWN_LETTERS]}…"


def _first_line(error: Exception) -> str:
    return str(error).split("\n")[0].split(" (")[0]
