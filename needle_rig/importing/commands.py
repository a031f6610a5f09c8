"""The command that a trial's motion shows: angles at which the base rests, its speed, the load on the tip."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from needle_rig.dataset import DatasetTrial, TrialCommand
from needle_rig.numerics import Array
from needle_rig.units import nmm

SAME_LEVEL_DEG = 1.0
SAME_SPEED = 0.15
"""Relative; a drive's mean speed over a stroke scatters less than this."""
SAME_LOAD = 0.1
"""Of the largest torque on the tip in the recording: loads that differ by less are one."""


def commanded(trials: Sequence[DatasetTrial]) -> list[DatasetTrial]:
    """Trials with the command that their motion shows; equal ones within a drive's scatter are replicates."""
    kinds: list[tuple[Array, float, float, TrialCommand]] = []
    result = []
    loads = [_load_nmm(trial) for trial in trials]
    same_nmm = SAME_LOAD * max(map(abs, loads), default=0.0)
    for trial, load in zip(trials, loads, strict=True):
        steps, speed = _motion(trial)
        command = next(
            (
                c
                for s, v, w, c in kinds
                if len(s) == len(steps)
                and bool(np.all(np.abs(s - steps) <= SAME_LEVEL_DEG))
                and abs(v - speed) <= SAME_SPEED * max(v, speed)
                and abs(w - load) <= same_nmm
            ),
            None,
        )
        if command is None:
            told = tuple(float(round(x * 2) / 2) for x in steps)
            command = TrialCommand(
                "staircase" if told else "unknown",
                speed_deg_s=float(f"{speed:.2g}") if speed > 0 else None,
                steps_deg=told,
                other=(("tip_torque_nmm", repr(float(f"{load:.3g}"))),)
                if trial.trial.tip_torque_nm is not None
                else (),
            )
            kinds.append((steps, speed, load, command))
        result.append(dataclasses.replace(trial, command=command))
    return result


def _load_nmm(trial: DatasetTrial) -> float:
    """Median torque on the tip, N·mm; 0 where none was measured."""
    torque_nm = trial.trial.tip_torque_nm
    return 0.0 if torque_nm is None else nmm(float(np.median(torque_nm)))


def _motion(trial: DatasetTrial) -> tuple[Array, float]:
    """Angles to which the base goes to rest, in order, °, and the median speed of its motions, °/s."""
    time_s, base = trial.trial.time_s, np.degrees(trial.trial.base_angle_rad)
    still = np.concatenate(([True], np.abs(np.diff(base)) < 1e-9))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.view(np.int8), [0]))))
    levels = [
        float(np.median(base[a:b]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if time_s[b - 1] - time_s[a] >= 0.3
    ]
    before = [base[0], *levels]
    steps = [x for x, last in zip(levels, before, strict=False) if abs(x - last) > SAME_LEVEL_DEG]
    if base.max() > max(before) + SAME_LEVEL_DEG or base.min() < min(before) - SAME_LEVEL_DEG:
        steps = []  # a base that swings beyond its rests does not go from one to the next
    rates = np.abs(np.diff(base) / np.diff(time_s))
    moving = rates[rates > 0.1 * rates.max()] if len(rates) and rates.max() > 0 else np.empty(0)
    return np.array(steps), float(np.median(moving)) if len(moving) else 0.0
