"""Recordings and their mapping to a dataset: one clock, SI, cut into trials, checked."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from needle_rig.config.places import Places, show_path
from needle_rig.dataset import Dataset, DatasetTrial, TrialCommand, in_series
from needle_rig.dataset.description import layout_of, needle_of
from needle_rig.dataset.samples import FEWEST_SAMPLES, LeftOut, checked_trial
from needle_rig.errors import BadInput
from needle_rig.importing import signals
from needle_rig.importing.mapping import BASE, TORQUE, ChannelPart, ClockPart, Mapping, found_file
from needle_rig.importing.plausibility import impossible
from needle_rig.importing.reader import read_recording
from needle_rig.importing.recording import Column, Recording
from needle_rig.importing.unit_text import unit_of
from needle_rig.numerics import Array

REST_S = 1.0
"""Shortest rest between trials; holds inside of one are as long, but not at the start's angle and torque."""
STILL_DEG = 0.3
"""What a base at rest shows of noise and creep; one that passes by at 1°/s shows more."""
SAME_ANGLE_DEG = 1.0
"""What a dataset takes for the start's angle (`AT_REST_DEG`)."""
SAME_TORQUE = 0.1
"""Of the torque's span: a shaft that holds more than that is wound, and its trial goes on."""
SAME_SENSOR_DEG = 3.0
"""As `WOUND_DEG` of datasets: a needle that stands farther from where it began is wound."""
SAME_LEVEL_DEG = 1.0
SAME_SPEED = 0.15
"""Relative; a drive's mean speed over a stroke scatters less than this."""
OVERLAP = 0.5
SLOWER = 1.5
"""A channel with this many times the dataset's step between samples keeps its own times."""


@dataclass(frozen=True)
class _Channel:
    """One channel in SI on the recording's common clock."""

    role: str
    time_s: Array
    values: Array


def dataset_of(mapping: Mapping, folder: Path, places: Places | None = None) -> Dataset:
    """The dataset that `mapping`, its files relative to `folder`, makes. Raises BadInput."""
    lacks = mapping.lacks()
    if lacks:
        raise BadInput("\n".join(lacks))
    rig = mapping.rig
    assert rig is not None
    layout = layout_of(rig, places or Places("layout"))
    sensors = tuple(s.name for s in rig.hall_sensors)
    trials: list[DatasetTrial] = []
    notes: list[str] = []
    count = max(len(clock.files) for clock in mapping.clocks.values())
    begin_s = 0.0
    for number in range(count):
        found, length_s = _recording(mapping, folder, number, sensors, begin_s, notes)
        trials += found
        begin_s += length_s
    if not trials:
        raise BadInput("\n".join([*notes, "no trial is left that can be used"]))
    trials = _commanded(trials)
    problems = impossible(trials, sensors, layout, needle_of(rig.needle))
    if problems:
        raise BadInput("\n".join(problems))
    notes += [note for trial in trials for note in trial.notes]
    return Dataset(
        mapping.name, layout, sensors, needle_of(rig.needle), in_series(tuple(trials)), tuple(notes)
    )


def _recording(
    mapping: Mapping, folder: Path, number: int, sensors: tuple[str, ...], begin_s: float, notes: list[str]
) -> tuple[list[DatasetTrial], float]:
    """The trials of the n-th recording, and its length in s."""
    read: dict[str, Recording] = {}
    for name, clock in mapping.clocks.items():
        file = clock.files[number]
        if file.path not in read:
            read[file.path] = read_recording(folder / file.path)
        found_file(file, read[file.path].sha256, f"clocks.{name}.files")
    of = {name: read[clock.files[number].path] for name, clock in mapping.clocks.items()}
    base_part = next(c for c in mapping.channels if c.role == BASE)
    source = show_path(of[base_part.clock].path)
    times: dict[tuple[str, str], Array] = {}

    def times_of(channel: ChannelPart) -> Array:
        clock = mapping.clocks[channel.clock]
        rows = len(_column(of[channel.clock], channel.source, f"channels.{channel.role}").values)
        key = (channel.clock, str(rows))
        if key not in times:
            times[key] = _times(of[channel.clock], channel.clock, clock, number, rows)
        return times[key]

    zero_s = float(np.nanmin(times_of(base_part)))
    channels = {}
    for part in mapping.channels:
        column = _column(of[part.clock], part.source, f"channels.{part.role}")
        if column.labels:
            raise BadInput(
                f"{show_path(of[part.clock].path)}: {part.source} holds words; name a column of numbers"
            )
        time_s = times_of(part) - zero_s
        good = np.isfinite(time_s)
        time_s, values = time_s[good], column.values[good]
        back = np.flatnonzero(np.diff(time_s) < 0)
        if back.size:
            raise BadInput(
                f"{show_path(of[part.clock].path)}: the time of {part.clock} goes back after row "
                f"{int(back[0]) + 1:,}, from "
                f"{time_s[back[0]]:g} s to {time_s[back[0] + 1]:g} s; cut the file there"
            )
        keep = np.concatenate(([True], np.diff(time_s) > 0))
        channels[part.role] = _Channel(part.role, time_s[keep], values[keep])
        if len(channels[part.role].time_s) < FEWEST_SAMPLES:
            raise BadInput(
                f"{show_path(of[part.clock].path)}: {part.source} has fewer than {FEWEST_SAMPLES} samples at "
                f"times of their own; is {part.clock} its clock?"
            )
    length_s = float(channels[BASE].time_s[-1])
    rows_s = _rows(channels, mapping.rate_hz)
    table = np.column_stack(
        [rows_s]
        + [
            _on_rows(channels.get(role), rows_s, channels[BASE], mapping.rate_hz)
            for role in (BASE, TORQUE, *sensors)
        ]
    )
    parts = {part.role: part for part in mapping.channels}
    cuts, notes_of_cut = _cuts(mapping, table, of, zero_s, number, parts, sensors)
    notes += [f"{source}: {note}" for note in notes_of_cut]
    trials = []
    for k, (first, last) in enumerate(cuts, 1):
        shown = source if len(cuts) == 1 else f"{source}, trial {k}"
        values = table[first:last].copy()
        start_s = begin_s + float(values[0, 0])
        values[:, 0] -= values[0, 0]
        _to_si(values, parts, sensors)
        absent = {role for role in (TORQUE, *sensors) if role not in parts}
        lines = np.arange(first + 1, first + 1 + len(values), dtype=np.int64)
        phase = np.full(len(values), "", dtype=np.str_)
        said: list[str] = []
        try:
            trials.append(
                checked_trial(
                    values, phase, lines, sensors, shown, TrialCommand("unknown"), start_s, said, absent
                )
            )
        except LeftOut as left:
            notes.append(f"{shown}: left out: {left.reason}")
    return trials, length_s + REST_S


def _column(recording: Recording, name: str, place: str) -> Column:
    column = recording.column(name)
    if column is None:
        names = [c.name for c in recording.columns]
        near = difflib.get_close_matches(name, names, 1, 0.6)
        hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(names[:12])}"
        raise BadInput(f"{place}: {show_path(recording.path)} has no column {name}; {hint}")
    return column


def _times(recording: Recording, name: str, clock: ClockPart, number: int, rows: int) -> Array:
    offset_s = clock.files[number].offset_s
    if clock.source is None:
        assert clock.rate_hz is not None
        return np.arange(rows) / clock.rate_hz + offset_s
    column = _column(recording, clock.source, f"clocks.{name}")
    if column.labels:
        raise BadInput(f"clocks.{name}: {clock.source} holds words; name a column of times, or write rate_hz")
    if len(column.values) != rows:
        raise BadInput(
            f"clocks.{name}: {clock.source} has {len(column.values)} rows, a channel on it {rows}; "
            "give that channel a clock of its own"
        )
    unit = unit_of(clock.unit or "")
    assert unit is not None
    return np.asarray(column.values * unit.si + offset_s, dtype=np.float64)


def _rows(channels: dict[str, _Channel], rate_hz: float | None) -> Array:
    """Times of the rows: the base's samples or an even grid, and every sample of slower channels."""
    base = channels[BASE].time_s
    if rate_hz is not None and rate_hz * float(base[-1]) > len(base) + 1:
        raise BadInput(
            f"rate_hz: {rate_hz:g} Hz is more than the {len(base) / float(base[-1]):.4g} Hz of base_angle; "
            "write a smaller one, or leave it out"
        )
    rows = base if rate_hz is None else np.arange(0.0, float(base[-1]), 1.0 / rate_hz)
    step = float(np.median(np.diff(rows)))
    for channel in channels.values():
        own = float(np.median(np.diff(channel.time_s)))
        if own > SLOWER * step and channel.role != BASE:
            kept = channel.time_s[(channel.time_s >= rows[0]) & (channel.time_s <= rows[-1])]
            away = (
                np.abs(rows - kept[np.clip(np.searchsorted(kept, rows), 0, len(kept) - 1)])
                if len(kept)
                else None
            )
            if away is None:
                continue
            before = np.abs(rows - kept[np.clip(np.searchsorted(kept, rows) - 1, 0, len(kept) - 1)])
            rows = np.union1d(rows[np.minimum(away, before) > OVERLAP * step], kept)
    return rows


def _on_rows(channel: _Channel | None, rows_s: Array, base: _Channel, rate_hz: float | None) -> Array:
    """At the rows: as sampled, averaged over a step, interpolated; NaN where a slow channel has none."""
    if channel is None:
        return np.full(len(rows_s), math.nan)
    time_s, values = channel.time_s, channel.values
    if len(time_s) == len(rows_s) and np.array_equal(time_s, rows_s):
        return values.copy()
    good = np.isfinite(values)
    time_s, values = time_s[good], values[good]
    if len(time_s) < 2:
        return np.full(len(rows_s), math.nan)
    own = float(np.median(np.diff(time_s)))
    step = 1.0 / rate_hz if rate_hz is not None else float(np.median(np.diff(base.time_s)))
    if own > SLOWER * step and channel.role != BASE:
        place = np.clip(np.searchsorted(time_s, rows_s), 0, len(time_s) - 1)
        return np.where(time_s[place] == rows_s, values[place], math.nan)
    first = np.searchsorted(time_s, rows_s - step / 2, side="left")
    last = np.searchsorted(time_s, rows_s + step / 2, side="right")
    total = np.concatenate(([0.0], np.cumsum(values - values[0])))
    many = last - first
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (total[last] - total[first]) / many + values[0]
    between = np.interp(rows_s, time_s, values, left=math.nan, right=math.nan)
    after = np.clip(np.searchsorted(time_s, rows_s), 1, len(time_s) - 1)
    wide = time_s[after] - time_s[after - 1] > 2.5 * max(own, step)
    between[wide] = math.nan
    return np.where(many >= 2, mean, between)


def _to_si(values: Array, parts: dict[str, ChannelPart], sensors: tuple[str, ...]) -> None:
    """Columns of the table from what the file holds to radians and N·m, in place."""
    rest = signals.rest_before_motion(values[:, 1])
    for k, role in enumerate((BASE, TORQUE, *sensors), start=1):
        part = parts.get(role)
        if part is None:
            continue
        unit = unit_of(part.unit or "")
        assert unit is not None
        zero = part.zero
        if zero == "start":
            begin = values[:rest, k]
            if not np.isfinite(begin).any():
                begin = values[np.isfinite(values[:, k]), k][:1]
            known = begin[np.isfinite(begin)]
            zero = float(known.mean()) if len(known) else 0.0
        values[:, k] = part.sign * part.scale * unit.si * (values[:, k] - zero)


def _cuts(
    mapping: Mapping,
    table: Array,
    of: dict[str, Recording],
    zero_s: float,
    number: int,
    parts: dict[str, ChannelPart],
    sensors: tuple[str, ...],
) -> tuple[list[tuple[int, int]], list[str]]:
    """First and end row of each trial."""
    how = mapping.trials
    rows_s = table[:, 0]
    if how.at == "whole":
        return [(0, len(rows_s))], []
    if how.at == "times":
        cuts = [(int(np.searchsorted(rows_s, a)), int(np.searchsorted(rows_s, b))) for a, b in how.times_s]
        empty = next((k for k, (a, b) in enumerate(cuts) if b - a < 2), None)
        if empty is not None:
            a, b = how.times_s[empty]
            raise BadInput(
                f"trials.times_s[{empty}]: {a:g} to {b:g} s lies outside of the recording, which is "
                f"{rows_s[-1]:.4g} s long"
            )
        return cuts, []
    if how.at == "column":
        assert how.clock is not None
        assert how.source is not None
        column = _column(of[how.clock], how.source, "trials")
        times = (
            _times(of[how.clock], how.clock, mapping.clocks[how.clock], number, len(column.values)) - zero_s
        )
        known = np.isfinite(column.values) & np.isfinite(times)
        place = np.clip(np.searchsorted(times[known], rows_s, side="right") - 1, 0, None)
        value = column.values[known][place]
        edges = [0, *(np.flatnonzero(np.diff(value)) + 1).tolist(), len(rows_s)]
        return list(pairwise(edges)), []
    si = table.copy()
    _to_si(si, parts, sensors)
    return _at_rests(si)


def _at_rests(si: Array) -> tuple[list[tuple[int, int]], list[str]]:
    """Cuts in the middle of rests where the shaft is as it was at the start.

    Friction remembers: where the base came back and the shaft is still wound, the trial goes on.
    """
    time_s = si[:, 0]
    known = np.isfinite(si[:, 1])
    base = np.interp(time_s, time_s[known], si[known, 1])
    near = np.abs(base) <= math.radians(SAME_ANGLE_DEG)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], near.view(np.int8), [0]))))
    spans = np.array([np.ptp(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in si.T[2:]])
    cuts, wound = [0], 0
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        inside = slice(start + (stop - start) // 4, stop - (stop - start) // 4)
        moves = math.degrees(float(np.ptp(base[inside]))) > STILL_DEG
        if start == 0 or stop == len(time_s) or moves or time_s[stop - 1] - time_s[start] < REST_S:
            continue
        now = [float(np.median(c[np.isfinite(c)])) if np.isfinite(c).any() else 0.0 for c in si[inside, 2:].T]
        limits = [SAME_TORQUE * spans[0], *([math.radians(SAME_SENSOR_DEG)] * (len(now) - 1))]
        if any(abs(v) > limit for v, limit in zip(now, limits, strict=True) if limit > 0):
            wound += 1
        else:
            cuts.append((start + stop) // 2)
    notes = []
    if wound:
        notes.append(
            f"{wound} rests at the start's angle find the shaft wound; the recording is not cut there, "
            "since friction remembers the way"
        )
    cuts.append(len(time_s))
    return list(pairwise(cuts)), notes


def _commanded(trials: Sequence[DatasetTrial]) -> list[DatasetTrial]:
    """Trials with the command that their motion shows; equal ones within a drive's scatter are replicates."""
    kinds: list[tuple[Array, float, TrialCommand]] = []
    result = []
    for trial in trials:
        steps, speed = _motion(trial)
        command = next(
            (
                c
                for s, v, c in kinds
                if len(s) == len(steps)
                and bool(np.all(np.abs(s - steps) <= SAME_LEVEL_DEG))
                and abs(v - speed) <= SAME_SPEED * max(v, speed)
            ),
            None,
        )
        if command is None:
            told = tuple(float(round(x * 2) / 2) for x in steps)
            command = TrialCommand(
                "staircase" if told else "unknown",
                speed_deg_s=float(f"{speed:.2g}") if speed > 0 else None,
                steps_deg=told,
            )
            kinds.append((steps, speed, command))
        result.append(dataclasses.replace(trial, command=command))
    return result


def _motion(trial: DatasetTrial) -> tuple[Array, float]:
    """Angles at which the base rests, in order, °, and the median speed of its motions, °/s."""
    time_s, base = trial.trial.time_s, np.degrees(trial.trial.base_angle_rad)
    still = np.concatenate(([True], np.abs(np.diff(base)) < 1e-9))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.view(np.int8), [0]))))
    held = [
        float(np.median(base[a:b]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if time_s[b - 1] - time_s[a] >= 0.3
    ]
    steps = [x for k, x in enumerate(held) if k > 0 and abs(x - held[k - 1]) > SAME_LEVEL_DEG]
    rates = np.abs(np.diff(base) / np.diff(time_s))
    moving = rates[rates > 0.1 * rates.max()] if len(rates) and rates.max() > 0 else np.empty(0)
    return np.array(steps), float(np.median(moving)) if len(moving) else 0.0
