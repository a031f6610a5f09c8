"""A mapping proposed from recordings: every line with its reason, and with its doubt where there is one."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from needle_rig.dataset.description import RigPart
from needle_rig.errors import BadInput
from needle_rig.importing import names, signals
from needle_rig.importing.guess.channels import channels_of
from needle_rig.importing.guess.clocks import clock_of, doubt_speed, on_one_clock
from needle_rig.importing.guess.series import LARGEST_NUMBER, Series
from needle_rig.importing.guess.trials import rate_of_dataset, trials_of
from needle_rig.importing.mapping import ClockPart, FilePart, Mapping
from needle_rig.importing.recording import Recording


def guess(recordings: Sequence[Recording], name: str, rig: RigPart | None, folder: Path) -> Mapping:
    """The mapping of `recordings`: files with the same columns are one recording after the other.

    `rig` says what the shaft looks like, where it is known; paths are written relative to `folder`. Raises
    BadInput when there is nothing that could be the base's angle.
    """
    kinds: dict[tuple[tuple[str, str], ...], list[Recording]] = {}
    for recording in recordings:
        kinds.setdefault(tuple((c.table, c.name) for c in recording.columns), []).append(recording)
    clocks: dict[str, ClockPart] = {}
    series: list[Series] = []
    not_used: list[str] = []
    for files in kinds.values():
        first = files[0]
        parts = tuple(FilePart(path=os.path.relpath(r.path, folder), sha256=r.sha256) for r in files)
        for table, columns in first.tables().items():
            label = _label(first.path, table, clocks, len(first.tables()) > 1)
            part, time_s, source = clock_of(columns, first, table, parts)
            clocks[label] = part
            if time_s is None:
                time_s = np.arange(len(columns[0].values), dtype=np.float64)
            known = np.flatnonzero(np.isfinite(time_s))
            looked_at = known[:: max(1, len(known) // signals.LOOKED_AT)]
            for column in columns:
                if column.name == source:
                    continue
                if column.labels or names.says(column.name, names.TIME):
                    not_used.append(column.name)
                    continue
                seen = column.values[looked_at]
                seen = np.where(np.abs(seen) < LARGEST_NUMBER, seen, math.nan)
                series.append(Series(column, label, time_s[looked_at], seen))
    if len({len(c.files) for c in clocks.values()}) > 1:
        told = "; ".join(f"{k}: {len(c.files)}" for k, c in clocks.items())
        raise BadInput(
            f"files of different kinds do not pair ({told}); import the recordings one by one, "
            "each with the files of its own"
        )
    trials, series, more = trials_of(series)
    clocks, series = on_one_clock(clocks, series)
    channels, unused = channels_of(series, rig, recordings)
    used = {(c.clock, c.source) for c in channels}
    clocks = {k: v for k, v in clocks.items() if any(c.clock == k for c in channels)}
    clocks = doubt_speed(clocks, channels, series)
    not_used += [s.column.name for s in series if (s.clock, s.column.name) not in used] + more
    return Mapping(
        name=name,
        clocks=clocks,
        channels=tuple(channels),
        trials=trials,
        rate_hz=rate_of_dataset(series, channels),
        not_used=tuple(dict.fromkeys([*unused, *not_used])),
        rig=rig,
    )


def _label(path: Path, table: str, taken: dict[str, ClockPart], several: bool) -> str:
    """A name for the clock of a table that no other clock has."""
    stem = path.name.split(".")[0] or "clock"
    label = f"{stem}/{table}" if several and table else stem
    label = label.replace(" ", "_")
    number = 2
    while label in taken:
        label, number = f"{label}_{number}", number + 1
    return label
