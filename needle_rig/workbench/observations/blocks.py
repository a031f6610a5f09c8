"""One command alone: its trials cut into blocks of time, so that something can be left out of a fit."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.workbench.observations.binning import motions_of

BLOCKS = 4
"""A quarter is left out at a time: with fewer too little is left to fit, with more a block is one motion of
Reed's five."""
FEWEST_SAMPLES = 10
"""Of a block, as of a trial."""
NOTE = (
    f"One command alone was recorded: its time is cut into {BLOCKS} blocks, each left out in turn. This tells"
    " whether a model predicts the rest of the recording, not another target, speed or dwell:"
    " add trials with another one."
)


def in_blocks(dataset: Dataset) -> Dataset:
    """The dataset; one of a single command with every trial as blocks of its time, a command each.

    A block is driven by the whole path up to its end, since friction remembers, and compared inside of itself
    alone. Trials too short to be cut leave the dataset as it is.
    """
    if len({t.command for t in dataset.trials}) != 1:
        return dataset
    if any(np.count_nonzero(_known(t)) < BLOCKS * FEWEST_SAMPLES for t in dataset.trials):
        return dataset
    trials = tuple(block for t in dataset.trials for block in _blocks(t))
    return dataclasses.replace(dataset, trials=trials, notes=(*dataset.notes, NOTE))


def _known(trial: DatasetTrial) -> np.ndarray:
    """True at samples with a torque or an angle."""
    return np.asarray(trial.torque_ok | trial.hall_ok.any(axis=1))


def _blocks(trial: DatasetTrial) -> list[DatasetTrial]:
    drive, found = trial.trial, []
    for k, (first, end) in enumerate(pairwise(_edges(trial)), 1):
        inside = np.arange(end) >= first
        parts = (*trial.command.other, ("block", f"{k} of {BLOCKS}"))
        begin_s, end_s = drive.time_s[first], drive.time_s[end - 1]
        found.append(
            dataclasses.replace(
                trial,
                trial=dataclasses.replace(
                    drive,
                    time_s=drive.time_s[:end],
                    base_angle_rad=drive.base_angle_rad[:end],
                    tip_torque_nm=None if drive.tip_torque_nm is None else drive.tip_torque_nm[:end],
                ),
                base_measured_rad=trial.base_measured_rad[:end],
                torque_nm=np.where(inside, trial.torque_nm[:end], np.nan),
                hall_rad=np.where(inside[:, None], trial.hall_rad[:end], np.nan),
                phase=trial.phase[:end],
                command=dataclasses.replace(trial.command, other=parts),
                file=f"{trial.file}, {begin_s:.4g} to {end_s:.4g} s",
                start_change=None if trial.start_change is None else trial.start_change[..., :end],
            )
        )
    return found


def _edges(trial: DatasetTrial) -> list[int]:
    """First sample of each block and the end of the last: equal shares of what is known, at ends of motions
    that lie near."""
    known = np.flatnonzero(_known(trial))
    shares = [int(known[len(known) * k // BLOCKS]) for k in range(1, BLOCKS)]
    ends = np.array([end for _, _, end in motions_of(trial.trial.base_angle_rad, np.asarray(trial.phase))])
    reach = len(known) // (2 * BLOCKS)
    edges = [int(known[0])]
    for share in shares:
        nearest = int(ends[np.argmin(np.abs(ends - share))])
        edge = nearest if abs(nearest - share) <= reach else share
        if np.count_nonzero((known >= edges[-1]) & (known < edge)) < FEWEST_SAMPLES:
            edge = share
        edges.append(edge)
    return [*edges, int(known[-1]) + 1]
