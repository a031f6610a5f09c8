"""The path of the base before a recording: put before a trial, so that the model's shaft starts as it did.

A few turns tell it, whatever came before (see `dataset.dominant_turns`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.dataset.dominant_turns import dominant_turns
from needle_rig.dataset.samples import AT_REST_DEG
from needle_rig.errors import NeedleRigError
from needle_rig.numerics import Array
from needle_rig.recording import RunFile
from needle_rig.units import deg, rad
from needle_rig.workbench.observations.runs import run_as_trial

PHASE = "run-in"
TURN_SAMPLES, TURN_S = 6, 2.0
REST_S = 1.0
SAME_S = 1e-9
"""Times of one instant: a turn that begins where the one before it ends."""
SEEN_S = 0.2
"""At the end of one run and the beginning of the next, that the needle stayed where it was."""
MOST_RUNS = 20
"""That are looked back through: friction has forgotten what the shaft was before them."""


def with_path_before(
    trial: DatasetTrial, corners_rad: Sequence[float], came_s: Sequence[float] = ()
) -> DatasetTrial:
    """The trial after a path of the base from 0 along `corners_rad` to its start; nothing is seen there.

    A torque on the tip is what it is at the start. The base came to a corner `came_s` before the trial, which
    friction that ages remembers: a turn takes `TURN_S` or less, and it stands until the next one. Without
    times each takes `TURN_S`, one after the other; the base then rests for `REST_S`.
    """
    base_rad = float(trial.trial.base_angle_rad[0])
    begin_s = float(trial.trial.time_s[0])
    corners = np.array([0.0, *corners_rad, *([] if came_s else [base_rad])])
    turns = len(corners) - 1
    end_s = begin_s - (np.array(came_s) if came_s else REST_S + TURN_S * np.arange(turns)[::-1])
    lasts_s = np.minimum(TURN_S, np.diff(end_s, prepend=-np.inf))
    share = np.arange(TURN_SAMPLES + 1) / TURN_SAMPLES
    time_s = ((end_s - lasts_s)[:, None] + lasts_s[:, None] * share).ravel()
    path = (corners[:-1, None] + np.diff(corners)[:, None] * share).ravel()
    apart = np.diff(time_s, append=np.inf) > SAME_S
    time_s = np.r_[time_s[apart], 0.5 * (begin_s + end_s[-1])]
    path = np.r_[path[apart], base_rad]
    count = len(path)
    unseen = np.full((count, trial.hall_rad.shape[1]), np.nan)
    drive, change = trial.trial, trial.start_change
    tip_nm = drive.tip_torque_nm
    return dataclasses.replace(
        trial,
        trial=dataclasses.replace(
            drive,
            time_s=np.r_[time_s, drive.time_s],
            base_angle_rad=np.r_[path, drive.base_angle_rad],
            tip_torque_nm=None if tip_nm is None else np.pad(tip_nm, (count, 0), mode="edge"),
        ),
        base_measured_rad=np.r_[path, trial.base_measured_rad],
        torque_nm=np.r_[np.full(count, np.nan), trial.torque_nm],
        hall_rad=np.vstack([unseen, trial.hall_rad]),
        phase=np.concatenate([np.full(count, PHASE), trial.phase]),
        start_change=None if change is None else np.pad(change, ((0, 0), (0, 0), (count, 0))),
    )


def with_known_paths(dataset: Dataset) -> Dataset:
    """The dataset; trials before which the base is known to have turned, after that path."""
    if not any(trial.turns_before_rad for trial in dataset.trials):
        return dataset
    trials = (
        dataclasses.replace(
            with_path_before(trial, trial.turns_before_rad, trial.turns_before_s),
            turns_before_rad=(),
            turns_before_s=(),
        )
        if trial.turns_before_rad
        else trial
        for trial in dataset.trials
    )
    return dataclasses.replace(dataset, trials=tuple(trials))


def after_earlier_runs(dataset: Dataset, runs: Sequence[RunFile]) -> Dataset:
    """The dataset of `runs`; a shaft that earlier runs wound starts as they left it, with a sentence.

    They are looked for in the folders of `runs`, back to one that began relaxed or `MOST_RUNS`; each must
    have ended where the next begins. A trial of which they do not tell stays as it is.
    """
    by_shown = {str(run.path): run for run in runs}
    known: dict[Path, DatasetTrial | None] = {}
    trials, notes = [], []
    for trial in dataset.trials:
        earlier = _earlier(by_shown[trial.file], trial, known) if trial.file in by_shown else []
        if not earlier:
            trials.append(trial)
            continue
        path = np.concatenate([before.trial.base_angle_rad for before in earlier])
        turns = path[dominant_turns(path)]
        trials.append(dataclasses.replace(trial, start="relaxed", turns_before_rad=tuple(turns)))
        told = ", ".join(f"{deg(turn):.0f}" for turn in turns)
        before = f"the {len(earlier)} runs before it" if len(earlier) > 1 else "the run before it"
        notes.append(f"{trial.file}: begins as {before} left the shaft, after turns of the base to {told}°")
    return dataclasses.replace(dataset, trials=tuple(trials), notes=(*dataset.notes, *notes))


def _earlier(run: RunFile, trial: DatasetTrial, known: dict[Path, DatasetTrial | None]) -> list[DatasetTrial]:
    """The runs that wound the shaft, oldest first; none where it was relaxed, or one of them is missing."""
    found: list[DatasetTrial] = []
    first = trial
    for path in sorted(run.path.parent.glob(f"*{run.path.suffix}"), reverse=True):
        if path.name >= run.path.name:
            continue
        if path not in known:
            known[path] = _of_the_same_rig(path, run)
        before = known[path]
        if before is None or not _goes_on(before, first):
            break
        found.insert(0, before)
        first = before
        if len(found) == MOST_RUNS:
            return found
    return found if first.start == "relaxed" else []


def _of_the_same_rig(path: Path, run: RunFile) -> DatasetTrial | None:
    """The run at `path` as a trial; None where it holds none, or was made on another rig than `run`."""
    try:
        other = RunFile(path)
        same = (other.config.layout, other.config.needle) == (run.config.layout, run.config.needle)
        return run_as_trial(other) if same and other.simulated == run.simulated else None
    except NeedleRigError:
        return None


def _goes_on(before: DatasetTrial, after: DatasetTrial) -> bool:
    """Whether base and sensors began where they had ended."""
    end, begin = before.trial.time_s[-1] - SEEN_S, after.trial.time_s[0] + SEEN_S
    last = np.column_stack([before.trial.base_angle_rad, before.hall_rad])[before.trial.time_s >= end]
    first = np.column_stack([after.trial.base_angle_rad, after.hall_rad])[after.trial.time_s <= begin]
    moved = np.abs(_means(first) - _means(last))
    return bool(np.all(moved[np.isfinite(moved)] < rad(AT_REST_DEG)))


def _means(values: Array) -> Array:
    """Mean of the numbers in each column; NaN where there are none."""
    known = [column[np.isfinite(column)] for column in values.T]
    return np.array([column.mean() if column.size else np.nan for column in known])
