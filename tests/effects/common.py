"""Trials and the library that the effects' tests share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.physics.effect import Effect, Trial
from needle_rig.physics.library import find_effects
from needle_rig.simulation.drive.base_drive import Motion, base_path

USERS = Path(__file__).parents[1] / "data" / "effects"
LIBRARY = find_effects([USERS])
"""The built-in effects and a user's: all are held to the same contract."""


def make_effect(name: str, *values: Any, **named: Any) -> Effect:
    """An effect of the library by its name, with values for its parameters."""
    make: Callable[..., Effect] = LIBRARY[name]
    return make(*values, **named)


def path(*knots: tuple[float, float], rate_hz: float = 50.0) -> Trial:
    """A trial through (time_s, base_deg)."""
    times, angles = np.array(knots).T
    time_s = np.arange(0, times[-1] + 1e-9, 1 / rate_hz)
    base_rad = np.radians(np.interp(time_s, times, angles))
    return Trial(time_s, base_rad, start_s=120.0, index=3, travel_before_rad=3 * 2 * np.pi)


SHORT = path((0, 0), (0.2, 0), (1.2, 45), (1.7, 45), (2.3, 71), (2.8, 71), (3.8, 25), (4.3, 25))
SETTLED_S = (4.4, 8.0, 12.1, 15.7, 19.0)
SEQUENCE = path(
    *[(0, 0), (0.5, 0), (1.5, 45), (4.5, 45), (5.1, 71), (8.1, 71)],
    *[(9.2, 25.5), (12.2, 25.5), (12.8, 51.5), (15.8, 51.5), (16, 45), (19.1, 45)],
)
"""The 45° sequence: five motions, 3 s rests."""


def driven(trial: Trial, rate_rad_s: float = np.radians(45)) -> Trial:
    """`trial` as a drive turns it that cannot start and stop at once: the corners take its lags."""
    turns = np.flatnonzero(np.diff(trial.base_angle_rad))
    starts = turns[np.r_[True, np.diff(turns) > 1]]
    ends = turns[np.r_[np.diff(turns) > 1, True]] + 1
    motions = tuple(
        Motion("turn", float(trial.time_s[a]), from_rad, to_rad, rate_rad_s, 0.0)
        for a, from_rad, to_rad in zip(
            starts, trial.base_angle_rad[starts].tolist(), trial.base_angle_rad[ends].tolist(), strict=True
        )
    )
    return replace(trial, base_angle_rad=base_path(motions, trial.time_s))
