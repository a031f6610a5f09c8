"""Datasets from disk. What is wrong with a file is an error with its line, or is handled and said."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from needle_rig.config.places import show_path
from needle_rig.dataset.description import (
    layout_of,
    lever_of,
    needle_of,
    read_description,
    unknown_keys,
)
from needle_rig.dataset.notes import gathered
from needle_rig.dataset.records import Dataset, DatasetTrial, in_series
from needle_rig.dataset.samples import LeftOut
from needle_rig.dataset.trial_file import read_trial
from needle_rig.dataset.units_check import check_units, guessed_rigidity, judge_starts
from needle_rig.errors import BadInput

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


def read_dataset(path: Paths) -> Dataset:
    """The dataset in a folder, or the trials of several folders of one rig as one series.

    Trials that cannot be used (too few samples, not at rest at the start) are left out and named in `notes`.
    Raises BadInput, with file and line, for anything else that cannot be used.
    """
    several = [path] if isinstance(path, str | os.PathLike) else list(path)
    if not several:
        raise BadInput("no dataset was named; give a folder with a dataset.yaml")
    datasets = [_read_one(Path(p)) for p in several]
    return datasets[0] if len(datasets) == 1 else joined(datasets)


def joined(datasets: Sequence[Dataset]) -> Dataset:
    """The trials of several datasets of one rig as one series, in the order given.

    Raises BadInput when their layouts or needles differ.
    """
    first = datasets[0]
    notes = list(first.notes)
    trials = list(first.trials)
    for other in datasets[1:]:
        if not _same_layout(other, first):
            raise BadInput(
                f"{other.name} has another layout than {first.name}; compare datasets of one rig together"
            )
        if not np.allclose(dataclasses.astuple(other.needle), dataclasses.astuple(first.needle), rtol=1e-6):
            raise BadInput(
                f"{other.name} has another needle than {first.name}; compare datasets of one needle together"
            )
        end_s = max(t.trial.start_s + float(t.trial.time_s[-1]) for t in trials)
        notes.extend(other.notes)
        notes.append(
            f"{other.name}: its clock is taken to go on where the one before it ended, at {end_s:.1f} s"
        )
        trials.extend(
            dataclasses.replace(t, trial=dataclasses.replace(t.trial, start_s=t.trial.start_s + end_s))
            for t in other.trials
        )
    name = " + ".join(dict.fromkeys(d.name for d in datasets))
    return dataclasses.replace(first, name=name, trials=in_series(tuple(trials)), notes=tuple(notes))


def _same_layout(one: Dataset, other: Dataset) -> bool:
    """Whether two datasets are of one layout, to a nanometre."""
    if (one.sensor_names, one.machine, one.lever_m) != (other.sensor_names, other.machine, other.lever_m):
        return False
    if one.layout.tip_clamped != other.layout.tip_clamped:
        return False
    places = [
        np.array(
            [
                d.layout.needle_length_m,
                *sum(d.layout.tissue_sections_m, ()),
                *d.layout.sensor_positions_m,
                *sum(d.layout.segments, ()),
            ]
        )
        for d in (one, other)
    ]
    return places[0].shape == places[1].shape and np.allclose(places[0], places[1], rtol=0.0, atol=1e-9)


def _read_one(path: Path) -> Dataset:
    if path.name == "dataset.yaml" and os.path.isfile(path):
        path = path.parent
    if not os.path.isdir(path):
        if os.path.lexists(path):
            raise BadInput(f"{show_path(path)}: is no folder; name the folder that has the dataset.yaml")
        raise BadInput(f"{show_path(path)}: there is no such folder")
    if not os.path.lexists(path / "dataset.yaml"):
        inside = sorted(p.parent.name for p in path.glob("*/dataset.yaml"))
        hint = f"; did you mean {', '.join(inside[:6])} in it?" if inside else ""
        if os.path.lexists(path / "settled.yaml"):
            hint = ", only settled values (settled.yaml): compare, diagnose and adopt read those"
        raise BadInput(f"{show_path(path)}: has no dataset.yaml{hint}")
    description, places = read_description(path)
    layout = layout_of(description.rig, places)
    sensors = tuple(s.name for s in description.rig.hall_sensors)
    needle = needle_of(description.rig.needle)
    notes = unknown_keys(description, places)
    trials: list[DatasetTrial] = []
    left_out: list[str] = []
    end_s = 0.0
    for place, part in enumerate(description.trials):
        start_s = part.start_s
        if start_s is None:
            start_s = end_s
            notes.append(f"{places.of(('trials', place))}: start_s is missing; taken as {end_s:.1f} s")
        try:
            trial = read_trial(path / part.file, path, sensors, part.command(), start_s, part.start)
        except LeftOut as reason:
            left_out.append(str(reason))
            notes.append(str(reason))
            continue
        if layout.tip_clamped and trial.trial.tip_torque_nm is not None:
            raise BadInput(
                f"{trial.file}:1: tip_torque acts on a tip that dataset.yaml calls clamped; it can move a"
                " free tip alone: remove the column or write `tip: free`"
            )
        end_s = start_s + float(trial.trial.time_s[-1])
        if part.turns_before_deg and part.start != "relaxed":
            raise BadInput(
                f"{places.of(('trials', place))}: start {part.start} is an unknown twist, and"
                " turns_before_deg tells it; keep one"
            )
        came_s, turns = part.turns_before_s, part.turns_before_deg
        if came_s and (len(came_s) != len(turns) or any(b >= a for a, b in pairwise(came_s))):
            raise BadInput(
                f"{places.of(('trials', place))}: turns_before_s is how long before the trial the base came"
                f" to each of turns_before_deg; give {len(turns)} falling numbers, or leave it out"
            )
        turns_rad = tuple(map(math.radians, turns))
        trials.append(dataclasses.replace(trial, turns_before_rad=turns_rad, turns_before_s=came_s))
        notes.extend(trial.notes)
    if not needle.rigidity_is_known:
        needle, said = guessed_rigidity(trials, layout)
        notes.append(said)
    check_units(trials, layout, needle, sensors)
    kept, unlike = judge_starts(trials, sensors)
    notes.extend(unlike)
    if not kept:
        raise BadInput(
            "\n".join([*left_out, *unlike, f"{show_path(path)}: no trial is left that can be used"])
        )
    return Dataset(
        description.name,
        layout,
        sensors,
        needle,
        in_series(tuple(kept)),
        gathered(notes),
        simulated=description.simulated,
        machine=description.rig.machine,
        lever_m=lever_of(description.rig),
    )
