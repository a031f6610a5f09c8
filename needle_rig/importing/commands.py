"""The command that a trial's motion shows: angles at which the base rests, and its speed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from needle_rig.dataset import DatasetTrial, TrialCommand
from needle_rig.numerics import Array

SAME_LEVEL_DEG = 1.0
SAME_SPEED = 0.15
"""Relative; a drive's mean speed over a stroke scatters less than this."""


def commanded(trials: Sequence[DatasetTrial]) -> list[DatasetTrial]:
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
    levels = [
        float(np.median(base[a:b]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if time_s[b - 1] - time_s[a] >= 0.3
    ]
    steps = [x for k, x in enumerate(levels) if k > 0 and abs(x - levels[k - 1]) > SAME_LEVEL_DEG]
    rates = np.abs(np.diff(base) / np.diff(time_s))
    moving = rates[rates > 0.1 * rates.max()] if len(rates) and rates.max() > 0 else np.empty(0)
    return np.array(steps), float(np.median(moving)) if len(moving) else 0.0
