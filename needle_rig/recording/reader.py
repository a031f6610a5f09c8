"""Reads a run: finished, still being written, or left behind by a killed process."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np

from needle_rig.config.file_kinds import migrated
from needle_rig.config.loader import parse_rig_config
from needle_rig.config.places import show_path
from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput
from needle_rig.recording.hdf5_file import read_hdf5, read_journal
from needle_rig.recording.image import LATE
from needle_rig.recording.journal import SUFFIX, Frames, journal_path
from needle_rig.recording.liveness import being_written
from needle_rig.recording.structure import NOT_TABLES, check_attributes, check_times
from needle_rig.recording.tables import FORMAT, Rows
from needle_rig.records import JsonObject

Found = TypeVar("Found")


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
    result: JsonObject | None
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
        self.attributes: JsonObject
        self.tables: tuple[str, ...]
        self.attributes, self.tables = self._read(_about)

    @property
    def name(self) -> str:
        """The run's name: its file without the ending."""
        return self.path.stem

    def table(self, name: str) -> Rows:
        """All rows of table `name` as a structured array (see `tables.run_tables`)."""
        if name not in self.tables:
            raise BadInput(f"{self._shown}: has no table {name}; it has {', '.join(self.tables)}")
        rows: Rows = self._read(lambda file: _rows(file, name))
        return rows

    @property
    def events(self) -> tuple[Event, ...]:
        """The events in order of writing."""
        rows = self._read(lambda file: _rows(file, "events"))
        events: list[Event] = []
        for time_s, kind, raw in rows:
            text = raw.decode("utf-8", "replace")
            if kind or not events:
                events.append(Event(float(time_s), kind.decode("utf-8", "replace"), text))
            else:
                events[-1] = Event(events[-1].time_s, events[-1].kind, events[-1].text + text)
        return tuple(events)

    @property
    def simulated(self) -> bool:
        """Whether no real needle was turned."""
        return self.attributes.get("kind") == "simulated"

    def number(self, name: str, default: float = math.nan) -> float:
        """Attribute `name`, or `default` where there is none that is a number."""
        value = self.attributes.get(name)
        return float(value) if isinstance(value, int | float) else default

    @property
    def complete(self) -> bool:
        """Whether its writer closed it; False while it is written and after a kill."""
        return self.ending().complete

    @property
    def result(self) -> JsonObject | None:
        """The result with which the run ended, or None."""
        return self.ending().result

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time on the daemon's clock; (nan, nan) without a single row."""
        return self.ending().span_s

    def ending(self) -> Ending:
        """How far the run has come by now, in one look at the file."""
        return self._read(lambda file: _ending(file, self.tables))

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
        if os.path.lexists(self.path) or being_written(self.path):
            return 0
        frames = Frames(journal_path(self.path))
        with suppress(FileNotFoundError):  # it was closed in this moment
            for _ in frames:
                pass
        return frames.torn_bytes

    def _read(self, take: Callable[[h5py.File], Found]) -> Found:
        journal = journal_path(self.path)
        if not os.path.lexists(self.path) and os.path.isfile(journal):
            with suppress(FileNotFoundError):  # it ends in this moment, and has its file before that
                return read_journal(journal, self._shown, take)
        return read_hdf5(self.path, self._shown, take)


def _about(file: h5py.File) -> tuple[JsonObject, tuple[str, ...]]:
    attributes = {key: _plain(value) for key, value in file.attrs.items()} | _late(file)
    attributes = migrated(attributes, FORMAT)
    check_attributes(attributes)
    return attributes, tuple(sorted(set(file) - NOT_TABLES))


def _rows(file: h5py.File, name: str) -> Rows:
    rows = np.asarray(file[name][:])
    check_times(name, rows["time_s"])
    return rows


def _ending(file: h5py.File, tables: tuple[str, ...]) -> Ending:
    events = file["events"]
    found = _late(file).get("result")
    if isinstance(found, dict) and not str(found.get("status", "")).isprintable():
        raise ValueError("the status of its result has characters that cannot be shown")
    return Ending(
        complete=bool(len(events) and events[-1]["kind"] == b"end"),
        result=found if isinstance(found, dict) else None,
        span_s=_span(file, tables),
    )


def _late(file: h5py.File) -> JsonObject:
    """Attributes that were added after the start; a line cut off by a kill is left out."""
    known: JsonObject = {}
    if LATE in file:
        for line in bytes(file[LATE][:]).splitlines():
            with suppress(ValueError, RecursionError):
                said = json.loads(line)
                known |= said if isinstance(said, dict) else {}
    return known


def _span(file: h5py.File, tables: tuple[str, ...]) -> tuple[float, float]:
    filled = [name for name in tables if len(file[name]) and "time_s" in file[name].dtype.names]
    filled = filled or (["events"] if len(file["events"]) else [])
    times = [float(file[name][row]["time_s"]) for name in filled for row in (0, -1)]
    check_times(" or ".join(filled), np.array(times))
    return (min(times), max(times)) if times else (math.nan, math.nan)


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    plain = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, str):  # h5py keeps bytes that are no UTF-8 as lone surrogates
        return plain.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    if not isinstance(plain, int | float | np.ndarray):
        raise ValueError("an attribute is neither a text nor numbers")
    return plain
