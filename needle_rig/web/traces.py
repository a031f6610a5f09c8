"""Traces of a fitted problem as the page draws them: thinned, in degrees and N·mm, with their noise."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.numerics import Array
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.learning.places import motion_words, scale_of

TRIALS = 12
"""Drawn at most, the worst first."""
SAMPLES = 900
"""Of a trace: more than a plot of half a screen's width has dots across."""
_DIGITS_BELOW_NOISE = 1
"""One digit more than the noise allows, so that rounding is not seen."""

Document = dict[str, Any]


def channels_document(problem: Problem, dataset: Dataset) -> list[Document]:
    """By channel: name, unit and the standard deviation of a reading."""
    noise = problem.noise
    found = []
    for c, name in enumerate(("torque", *dataset.sensor_names)):
        factor, unit = scale_of(c)
        spread = factor * float(noise.within_trial[c])
        found.append({"name": name, "unit": unit, "noise": float(f"{spread:.3g}"), "digits": digits(spread)})
    return found


def digits(noise: float) -> int:
    """Decimals that a reading with this noise deserves."""
    return 4 if noise <= 0 else int(np.clip(-np.floor(np.log10(noise)) + _DIGITS_BELOW_NOISE, 0, 6))


def measured_document(dataset: Dataset, trial: DatasetTrial, decimals: list[int]) -> Document:
    """One trial as measured: time, base, channels and where its motions lie."""
    keep = kept(trial)
    values = np.vstack([trial.torque_nm[None, :], trial.hall_rad.T])
    time_s = trial.trial.time_s
    edges = np.flatnonzero(trial.phase[1:] != trial.phase[:-1]) + 1
    bounds = [0, *(int(e) for e in edges), len(time_s)]
    return {
        "file": trial.file,
        "title": title(trial),
        "time_s": _rounded(time_s[keep] - time_s[0], 3),
        "base_deg": _rounded(np.degrees(trial.base_measured_rad[keep]), 2),
        "measured": [
            _rounded(scale_of(c)[0] * row[keep], d)
            for c, (row, d) in enumerate(zip(values, decimals, strict=True))
        ],
        "motions": [
            {
                "name": str(trial.phase[a]),
                "words": motion_words(str(trial.phase[a])),
                "start_s": round(float(time_s[a] - time_s[0]), 3),
                "end_s": round(float(time_s[b - 1] - time_s[0]), 3),
            }
            for a, b in pairwise(bounds)
            if b > a
        ],
        "sensors": list(dataset.sensor_names),
    }


def model_document(
    problem: Problem, fit: Fit, t: int, trial: DatasetTrial, decimals: list[int]
) -> list[list[float | None]]:
    """What a fit predicts for trial `t`, by channel at the times of `measured_document`.

    Raises SolverError.
    """
    grid = problem.trials[t].trial
    reading = problem.model(fit.parameters, fit.vector, t).predict(grid)
    values = np.vstack([reading.torque_nm[None, :], reading.hall_rad.T])
    at_s = trial.trial.time_s[kept(trial)]
    return [
        _rounded(scale_of(c)[0] * np.interp(at_s, grid.time_s, row), d)
        for c, (row, d) in enumerate(zip(values, decimals, strict=True))
    ]


def kept(trial: DatasetTrial) -> slice:
    """Which samples are drawn."""
    return slice(None, None, max(1, -(-trial.trial.time_s.size // SAMPLES)))


def title(trial: DatasetTrial) -> str:
    """What the rig was commanded, in words."""
    command = trial.command
    if command.steps_deg:
        goal = f"{len(command.steps_deg)} steps"
    else:
        goal = "" if command.target_deg is None else f"to {command.target_deg:g}°"
    speed = f"at {command.speed_deg_s:g}°/s" if command.speed_deg_s else ""
    return " ".join(part for part in (command.kind, goal, speed) if part).replace("-", "−")


def _rounded(values: Array, decimals: int) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in np.round(values, decimals)]
