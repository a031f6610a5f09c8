"""Recordings and their mapping to a dataset: one clock, SI, cut into trials, checked."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from needle_rig.config.places import Places, show_path
from needle_rig.dataset import Dataset, DatasetTrial, TrialCommand, in_series
from needle_rig.dataset.description import layout_of, lever_of, needle_of
from needle_rig.dataset.records import Start
from needle_rig.dataset.samples import FEWEST_SAMPLES, LeftOut, checked_trial
from needle_rig.dataset.table import MAX_SAMPLES
from needle_rig.errors import BadInput
from needle_rig.importing import signals
from needle_rig.importing.axes import SUMMED, drift_sentence, summed
from needle_rig.importing.commands import commanded
from needle_rig.importing.guess.series import LEAST_FILLED, TURN_RAD
from needle_rig.importing.mapping import BASE, TIP_TORQUE, TORQUE, ChannelPart, Mapping, found_file
from needle_rig.importing.plausibility import impossible
from needle_rig.importing.reader import Recordings
from needle_rig.importing.recording import Recording
from needle_rig.importing.rows import Channel, at_rows, clock_times, column_of, row_times
from needle_rig.importing.si import to_si
from needle_rig.importing.trial_cuts import REST_S, cuts_of, turns_before
from needle_rig.importing.unit_text import Unit, unit_of
from needle_rig.numerics import Array
from needle_rig.physics.machine import MACHINES


def dataset_of(
    mapping: Mapping, folder: Path, places: Places | None = None, recordings: Recordings | None = None
) -> Dataset:
    """The dataset that `mapping`, its files relative to `folder`, makes. Raises BadInput.

    `places` says where each line of the mapping stands; `recordings` has files that were read already.
    """
    recordings = recordings or Recordings()
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
        found, length_s = _recording(mapping, folder, recordings, number, sensors, begin_s, notes)
        trials += found
        begin_s += length_s
    if not trials:
        raise BadInput("\n".join([*notes, "no trial is left that can be used"]))
    trials = commanded(trials)
    problems = impossible(trials, sensors, layout, needle_of(rig.needle), MACHINES[rig.machine])
    sure = {part.role for part in mapping.channels if part.sure}
    refused = [p.said for p in problems if not (p.of_size and p.role in sure)]
    if refused:
        raise BadInput("\n".join(refused))
    notes += [f"taken as confirmed: {p.said}" for p in problems]
    notes += [note for trial in trials for note in trial.notes]
    return Dataset(
        mapping.name,
        layout,
        sensors,
        needle_of(rig.needle),
        in_series(tuple(trials)),
        tuple(notes),
        machine=rig.machine,
        lever_m=lever_of(rig),
    )


def held(time_s: Array, shown: str, notes: list[str]) -> int:
    """How many of the samples of a trial at `time_s` a dataset holds, from the first on; `notes` tell where
    its end is left out."""
    if len(time_s) > MAX_SAMPLES:
        used_s, whole_s = (float(time_s[k] - time_s[0]) for k in (MAX_SAMPLES, -1))
        notes.append(
            f"{shown}: the first {used_s:.4g} s of {whole_s:.4g} s are used, as a trial holds {MAX_SAMPLES:,}"
            " samples; a smaller rate_hz averages over more of it"
        )
    return min(len(time_s), MAX_SAMPLES)


def _recording(
    mapping: Mapping,
    folder: Path,
    recordings: Recordings,
    number: int,
    sensors: tuple[str, ...],
    begin_s: float,
    notes: list[str],
) -> tuple[list[DatasetTrial], float]:
    """The trials of the n-th recording, and its length in s."""
    of: dict[str, Recording] = {}
    for name, clock in mapping.clocks.items():
        file = clock.files[number]
        same = (of[o] for o in of if mapping.clocks[o].files[number].is_same(file))
        of[name] = next(same, None) or recordings.read(
            folder / file.path, mapping.database(folder), file.table
        )
        found_file(file, of[name].sha256, f"clocks.{name}.files")
    base_part = next(c for c in mapping.channels if c.role == BASE)
    source = ", ".join(filter(None, (show_path(of[base_part.clock].path), of[base_part.clock].table)))
    times: dict[tuple[str, str], Array] = {}

    def times_of(channel: ChannelPart) -> Array:
        clock = mapping.clocks[channel.clock]
        rows = len(column_of(of[channel.clock], channel.source, f"channels.{channel.role}").values)
        key = (channel.clock, str(rows))
        if key not in times:
            times[key] = clock_times(of[channel.clock], channel.clock, clock, number, rows)
        return times[key]

    zero_s = float(np.nanmin(times_of(base_part)))
    channels = {}
    rates: list[tuple[ChannelPart, Unit, Array, Array]] = []
    for part in mapping.channels:
        column = column_of(of[part.clock], part.source, f"channels.{part.role}")
        if column.labels:
            raise BadInput(
                f"{show_path(of[part.clock].path)}: {part.source} holds words; name a column of numbers"
            )
        time_s = times_of(part) - zero_s
        values = column.values
        unit = unit_of(part.unit or "")
        if unit is not None and unit.dimension == "angle":
            # before anything is averaged: the mean of 359° and 1° is 180°
            plain = signals.without_wraps(values, TURN_RAD / (unit.si * part.scale))
            if plain is not values:
                notes.append(f"{source}: {part.role} ({part.source}) wraps by a whole turn; unwrapped")
            values = plain
        good = np.isfinite(time_s)
        filled = good & np.isfinite(values)
        if filled.sum() < LEAST_FILLED * good.sum():
            good = filled  # topics side by side, each with rows of its own
        time_s, values = time_s[good], values[good]
        if unit is not None and unit.dimension in SUMMED:
            assert part.zero != "start"
            rates.append((part, unit, time_s, values - part.zero))
            values = summed(time_s, values - part.zero)
        back = np.flatnonzero(np.diff(time_s) < 0)
        if back.size:
            raise BadInput(
                f"{show_path(of[part.clock].path)}: the time of {part.clock} goes back after row "
                f"{int(back[0]) + 1:,}, from "
                f"{time_s[back[0]]:g} s to {time_s[back[0] + 1]:g} s; cut the file there"
            )
        keep = np.concatenate(([True], np.diff(time_s) > 0))
        channels[part.role] = Channel(part.role, time_s[keep], values[keep])
        if len(channels[part.role].time_s) < FEWEST_SAMPLES:
            raise BadInput(
                f"{show_path(of[part.clock].path)}: {part.source} has fewer than {FEWEST_SAMPLES} samples at "
                f"times of their own; is {part.clock} its clock?"
            )
    notes += [
        f"{source}: {drift_sentence(part.role, part.source, time_s, rate, unit, mapping.lever_mm)}"
        for part, unit, time_s, rate in rates
    ]
    length_s = float(channels[BASE].time_s[-1])
    rows_s = row_times(channels, mapping.rate_hz)
    if mapping.trials.at == "whole":
        rows_s = rows_s[: held(rows_s, source, notes)]
    loaded = [TIP_TORQUE] if TIP_TORQUE in channels else []
    table = np.column_stack(
        [rows_s]
        + [
            at_rows(channels.get(role), rows_s, channels[BASE], mapping.rate_hz)
            for role in (BASE, TORQUE, *sensors, *loaded)
        ]
    )
    parts = {part.role: part for part in mapping.channels}
    start: Start = mapping.trials.start
    if start == "wound" and any(part.zero == "start" for role, part in parts.items() if role != BASE):
        start = "zeroed"
    cuts, notes_of_cut = cuts_of(mapping, table, of, zero_s, number, parts, sensors)
    notes += [f"{source}: {note}" for note in notes_of_cut]
    before: list[tuple[tuple[float, ...], tuple[float, ...]]] = [((), ())] * len(cuts)
    if mapping.trials.at == "rests" and start == "relaxed":
        whole = table.copy()
        to_si(whole, parts, sensors, mapping.lever_mm)
        before = turns_before(whole, cuts)
        remembered = sum(bool(turns) for turns, _ in before)
        if remembered:
            notes.append(
                f"{source}: {remembered} of {len(cuts)} trials begin with a twist that earlier ones left; the"
                " turns of the base that friction remembers are put before them"
            )
    trials = []
    for k, ((first, last), (turns_rad, came_s)) in enumerate(zip(cuts, before, strict=True), 1):
        shown = source if len(cuts) == 1 else f"{source}, trial {k}"
        values = table[first : first + held(table[first:last, 0], shown, notes)].copy()
        start_s = begin_s + float(values[0, 0])
        values[:, 0] -= values[0, 0]
        to_si(values, parts, sensors, mapping.lever_mm)
        absent = {role for role in (TORQUE, *sensors) if role not in parts}
        lines = np.arange(first + 1, first + 1 + len(values), dtype=np.int64)
        phase = np.full(len(values), "", dtype=np.str_)
        said: list[str] = []
        try:
            trial = checked_trial(
                values,
                phase,
                lines,
                sensors,
                shown,
                TrialCommand("unknown"),
                start_s,
                said,
                absent,
                start,
            )
            trials.append(dataclasses.replace(trial, turns_before_rad=turns_rad, turns_before_s=came_s))
        except LeftOut as left:
            notes.append(f"{shown}: left out: {left.reason}")
    return trials, length_s + REST_S
