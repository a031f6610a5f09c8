"""Reads a run: finished, still being written, or left behind by a killed process."""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from needle_rig.config.loader import parse_rig_config
from needle_rig.config.places import show_path
from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput
from needle_rig.recording.image import LATE, read_journal
from needle_rig.recording.journal import SUFFIX, Frames, journal_path
from needle_rig.recording.liveness import being_written
from needle_rig.recording.tables import FORMAT

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
SUPERBLOCK = struct.Struct("<8sB19xQ")
"""Signature, version and end of file of a superblock with 8-byte addresses."""


@dataclass(frozen=True)
class Event:
    """Something that happened during a run."""

    time_s: float
    kind: str
    text: str


@dataclass(frozen=True)
class Ending:
    """How far a run has come; see the properties of RunFile of these names."""

    complete: bool
    result: dict[str, Any] | None
    span_s: tuple[float, float]


class RunFile:
    """One run on disk. Holds no file open; every call reads what is there by then.

    Until the run ends that is the journal beside `path`.

    `attributes` has the run's request, config text, versions and start; `tables` the names of its tables.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Raises BadInput when there is no file at `path` or it is no run."""
        given = Path(path)
        self.path = given.with_suffix(".h5") if given.suffix == SUFFIX else given
        with self._open() as file:
            self.attributes: dict[str, Any] = {key: _plain(value) for key, value in file.attrs.items()}
            self.attributes |= _late(file)
            self.tables: tuple[str, ...] = tuple(sorted(set(file) - {"events", LATE}))
        if self.attributes.get("format") != FORMAT:
            raise BadInput(f"{self._shown}: is HDF5 but no run of needle-rig (no attribute format: {FORMAT})")

    @property
    def name(self) -> str:
        """The run's name: its file without the ending."""
        return self.path.stem

    def table(self, name: str) -> npt.NDArray[Any]:
        """All rows of table `name` as a structured array (see `tables.run_tables`)."""
        if name not in self.tables:
            raise BadInput(f"{self._shown}: has no table {name}; it has {', '.join(self.tables)}")
        with self._open() as file:
            return np.asarray(file[name][:])

    @property
    def events(self) -> tuple[Event, ...]:
        """The events in order of writing."""
        with self._open() as file:
            rows = file["events"][:]
        events: list[Event] = []
        for time_s, kind, raw in rows:
            text = raw.decode("utf-8", "replace")
            if kind or not events:
                events.append(Event(float(time_s), kind.decode("utf-8", "replace"), text))
            else:
                events[-1] = Event(events[-1].time_s, events[-1].kind, events[-1].text + text)
        return tuple(events)

    @property
    def complete(self) -> bool:
        """Whether its writer closed it; False while it is written and after a kill."""
        return self.ending().complete

    @property
    def result(self) -> dict[str, Any] | None:
        """The result with which the run ended, or None."""
        return self.ending().result

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time on the daemon's clock; (nan, nan) without a single row."""
        return self.ending().span_s

    def ending(self) -> Ending:
        """How far the run has come by now, in one look at the file."""
        with self._open() as file:
            events = file["events"]
            found = _late(file).get("result")
            return Ending(
                complete=bool(len(events) and events[-1]["kind"] == b"end"),
                result=found if isinstance(found, dict) else None,
                span_s=_span(file, self.tables),
            )

    @property
    def config(self) -> RigConfig:
        """The configuration under which the run was made."""
        return parse_rig_config(str(self.attributes.get("config", "")), f"{self._shown} (config inside)")

    @property
    def _shown(self) -> str:
        return show_path(self.path)

    @property
    def torn_bytes(self) -> int:
        """What a killed writer or a power cut left of a frame at the end of the journal; it is left out."""
        if self.path.is_file() or being_written(self.path):
            return 0
        frames = Frames(journal_path(self.path))
        with suppress(FileNotFoundError):  # it was closed in this moment
            for _ in frames:
                pass
        return frames.torn_bytes

    def _file(self) -> h5py.File:
        # a run that ends in this moment has its file before it loses its journal
        for path in (self.path, journal_path(self.path), self.path):
            with suppress(FileNotFoundError):
                if path.is_file() and path.suffix == SUFFIX:
                    return read_journal(path)
                if path.is_file():
                    self._refuse_cut()
                    return h5py.File(path, "r", swmr=True)
        raise BadInput(f"{self._shown}: there is no such run; list them with: needle-rig runs")

    @contextmanager
    def _open(self) -> Iterator[h5py.File]:
        try:
            file = self._file()
        except OSError as error:
            empty = self.path.is_file() and self.path.stat().st_size == 0
            reason = (
                "is empty: it was cut off before it began" if empty else f"is not a readable run ({error})"
            )
            raise BadInput(f"{self._shown}: {reason}") from None
        try:
            yield file
        except (OSError, KeyError, RuntimeError) as error:
            raise BadInput(f"{self._shown}: the file is damaged: {error}") from None
        finally:
            file.close()

    def _refuse_cut(self) -> None:
        """HDF5 hangs on a file that lost its end, or reads zeros there: see before it does.

        The superblock (version 2 and 3, HDF5 file format specification III.A) tells where the file ends; a
        writer that was killed leaves that at or before the true end.
        """
        with self.path.open("rb") as stream:
            head = stream.read(SUPERBLOCK.size)
        if len(head) < SUPERBLOCK.size:
            return
        signature, version, end = SUPERBLOCK.unpack(head)
        size = self.path.stat().st_size
        if signature == HDF5_SIGNATURE and version in (2, 3) and end > size:
            raise BadInput(
                f"{self._shown}: lost its end on the way: it has {size} of {end} bytes;"
                " copy it again from where it was recorded"
            )


def _late(file: h5py.File) -> dict[str, Any]:
    """Attributes that were added after the start; a line cut off by a kill is left out."""
    known: dict[str, Any] = {}
    if LATE in file:
        for line in bytes(file[LATE][:]).splitlines():
            with suppress(ValueError):
                known |= json.loads(line)
    return known


def _span(file: h5py.File, tables: tuple[str, ...]) -> tuple[float, float]:
    filled = [name for name in tables if len(file[name]) and "time_s" in file[name].dtype.names]
    filled = filled or (["events"] if len(file["events"]) else [])
    times = [float(file[name][row]["time_s"]) for name in filled for row in (0, -1)]
    return (min(times), max(times)) if times else (math.nan, math.nan)


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value.item() if isinstance(value, np.generic) else value
