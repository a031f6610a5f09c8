"""A mapping proposed from recordings: every line with its reason, and with its doubt where there is one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from needle_rig.config.places import show_path
from needle_rig.dataset.description import RigPart
from needle_rig.errors import BadInput
from needle_rig.importing import names
from needle_rig.importing.guess.channels import asked_lost, channels_of
from needle_rig.importing.guess.clocks import clock_of, doubt_speed, is_even, on_one_clock
from needle_rig.importing.guess.dropouts import doubt_dropouts
from needle_rig.importing.guess.kinds import kind_of
from needle_rig.importing.guess.known import Known
from needle_rig.importing.guess.series import Series, series_of
from needle_rig.importing.guess.trials import AT_RESTS, known_start, rate_of_dataset, trials_of
from needle_rig.importing.mapping import ClockPart, FilePart, Mapping, NotUsedPart, TrialsPart
from needle_rig.importing.recording import Column, Recording
from needle_rig.physics.machine import MachineName


def guess(
    recordings: Sequence[Recording],
    name: str,
    rig: RigPart | None,
    folder: Path,
    machine: MachineName | None = None,
    lever_mm: float | None = None,
) -> Mapping:
    """The mapping of `recordings`: files with the same columns are one recording after the other.

    `rig` says what the shaft looks like, where it is known; else one of `machine` is written, or of what the
    channels look like. `lever_mm` is the radius of what slides; paths are written relative to `folder`.
    Raises BadInput when there is nothing that could be the base's angle.
    """
    known = Known(rig, machine, lever_mm or (rig.lever_mm if rig else None))
    recordings = [part for recording in recordings for part in recording.repeats()]
    if not any(r.tables() for r in recordings):
        told = "; ".join(f"{c.name}: {c.fault}" for r in recordings for c in r.columns)
        raise BadInput(
            f"{show_path(recordings[0].path)}: no column of numbers ({told[:300]}); is it the right file?"
        )
    kinds: dict[tuple[tuple[str, str], ...], list[Recording]] = {}
    for recording in recordings:
        kinds.setdefault(tuple((c.table, c.name) for c in recording.columns), []).append(recording)
    clocks: dict[str, ClockPart] = {}
    series: list[Series] = []
    columns_of_clock: list[tuple[str, str]] = []
    why: dict[tuple[str, str], str] = {}
    """Of columns by clock and name: why they are not used, should nothing take them."""
    for files in kinds.values():
        first = files[0]
        parts = tuple(
            FilePart(path=os.path.relpath(r.path, folder), sha256=r.sha256, table=r.table) for r in files
        )
        tables = first.tables()
        for column in first.columns:
            if column.fault:
                key = (_place(first.path, column.table if len(tables) > 1 else ""), column.name)
                columns_of_clock.append(key)
                why[key] = column.fault
        for table, columns in tables.items():
            label = _label(first.path, table, clocks, len(tables) > 1)
            part, time_s, source = clock_of(columns, first, table, parts)
            clocks[label] = part
            if time_s is None:
                time_s = np.arange(len(columns[0].values), dtype=np.float64)
            for column in columns:
                key = (label, column.name)
                columns_of_clock.append(key)
                if column.name == source:
                    why[key] = "the clock of columns none of which is used"
                elif column.labels:
                    why[key] = f"holds words, as {column.labels[0][:30]!r}"
                elif names.says(column.name, names.TIME):
                    why[key] = _other_time(column, source)
                elif not kind_of(column)[0] and is_even(column.values):
                    why[key] = "counts up evenly, as rows or a clock do"
                else:
                    series.append(series_of(column, label, time_s))
    if len({len(c.files) for c in clocks.values()}) > 1:
        told = "; ".join(f"{k}: {len(c.files)}" for k, c in clocks.items())
        raise BadInput(
            f"files of different kinds do not pair ({told}); import the recordings one by one, "
            "each with the files of its own"
        )
    trials, series = trials_of(series)
    clocks, series = on_one_clock(clocks, series)
    channels, reasons = channels_of(series, known, recordings, why)
    channels = asked_lost(channels, [c for r in recordings for c in r.columns if c.fault], series, known.rig)
    channels = doubt_dropouts(channels, series)
    why |= reasons
    clocks = {k: v for k, v in clocks.items() if any(c.clock == k for c in channels)}
    if trials.clock is not None and trials.clock not in clocks:
        why[trials.clock, trials.source or ""] = "numbers trials on a clock without any channel"
        trials = TrialsPart(at="rests", why=AT_RESTS)
    clocks = doubt_speed(clocks, channels, series, known.machine, known.lever_mm)
    rig, layout = known.layout(channels)
    trials = known_start(trials, channels[0], series, rig, known.lever_mm)
    used = {(c.clock, c.source) for c in channels} | {(k, c.source) for k, c in clocks.items()}
    used.add((trials.clock or "", trials.source))
    return Mapping(
        name=name,
        clocks=clocks,
        channels=tuple(channels),
        trials=trials,
        rate_hz=rate_of_dataset(series, channels),
        not_used=tuple(
            NotUsedPart(clock=key[0], source=key[1], why=why[key])
            for key in columns_of_clock
            if key not in used
        ),
        rig=rig,
        layout=layout,
    )


def _other_time(column: Column, source: str) -> str:
    if source:
        return f"called a time, and {source} is the clock"
    known = column.values[np.isfinite(column.values)]
    back = np.flatnonzero(np.diff(known) < 0)
    if len(back):
        k = int(back[0])
        return f"called a time, and goes back from {known[k]:g} to {known[k + 1]:g} after its row {k + 1}"
    return "called a time, and does not count up"


def _place(path: Path, table: str) -> str:
    """How a table is called."""
    stem = path.name.split(".")[0] or "clock"
    return (f"{stem}/{table}" if table else stem).replace(" ", "_")


def _label(path: Path, table: str, taken: dict[str, ClockPart], several: bool) -> str:
    """A name for the clock of a table that no other clock has."""
    first = label = _place(path, table if several else "")
    number = 2
    while label in taken:
        label, number = f"{first}_{number}", number + 1
    return label
