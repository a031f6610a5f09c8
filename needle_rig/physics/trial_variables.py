"""What the base's path in a trial tells at each sample: rate, travel, time since the stop, direction.

Arrays have shape (samples,).
"""

from __future__ import annotations

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.units import rad

MOVES_RAD_S = rad(0.5)
"""A base that turns faster than this moves: ten times the rate that the noise of an encoder leaves on a
denoised path, a tenth of the slowest commanded rate."""


def rate_rad_s(trial: Trial) -> Array:
    """Rate of the base (samples,), rad/s, by central differences."""
    if trial.time_s.size < 2:
        return np.zeros_like(trial.base_angle_rad)
    return np.asarray(np.gradient(trial.base_angle_rad, trial.time_s))


def travel_rad(trial: Trial) -> Array:
    """Sum of |base motion| since the trial began (samples,), rad."""
    return np.asarray(np.cumsum(np.abs(_moved_rad(trial))))


def forward_travel_rad(trial: Trial) -> Array:
    """Sum of counter-clockwise base motion since the trial began (samples,), rad."""
    return np.asarray(np.cumsum(np.maximum(_moved_rad(trial), 0.0)))


def backward_travel_rad(trial: Trial) -> Array:
    """Sum of clockwise base motion since the trial began (samples,), rad, positive."""
    return np.asarray(np.cumsum(np.maximum(-_moved_rad(trial), 0.0)))


def _moved_rad(trial: Trial) -> Array:
    return np.diff(trial.base_angle_rad, prepend=trial.base_angle_rad[:1])


def clock_s(trial: Trial) -> Array:
    """Time on the clock of the series (samples,), s."""
    return np.asarray(trial.start_s + trial.time_s)


def stop_time_s(trial: Trial) -> Array:
    """Time since the base last moved, or since the trial began (samples,), s."""
    moves = np.abs(rate_rad_s(trial)) > MOVES_RAD_S
    return np.asarray(trial.time_s - np.maximum.accumulate(np.where(moves, trial.time_s, trial.time_s[:1])))


def direction(trial: Trial) -> Array:
    """Sign of the last motion of the base (samples,): −1, 1, or 0 before the first."""
    rate = rate_rad_s(trial)
    moves = np.abs(rate) > MOVES_RAD_S
    last = np.maximum.accumulate(np.where(moves, np.arange(rate.size), -1))
    return np.asarray(np.where(last >= 0, np.sign(rate[last]), 0.0))


def left_behind_rad(angle_rad: Array, play_rad: float, held_rad: float | None) -> tuple[Array, float | None]:
    """How far an angle (samples,) is ahead of what follows it with a play, and where that ends.

    The stop operator, which with the play operator adds up to the angle (Brokate, Sprekels, "Hysteresis and
    phase transitions" (1996), ch. 2). Without `held_rad` what follows begins centred.
    """
    half, held = 0.5 * play_rad, held_rad
    ahead = np.empty_like(angle_rad)
    for i, angle in enumerate(angle_rad.tolist()):
        held = angle if held is None else min(max(held, angle - half), angle + half)
        ahead[i] = angle - held
    return ahead, held
