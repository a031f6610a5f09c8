"""The base's path under an overdamped drive: a ramp at the commanded speed through two equal lags."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from needle_rig.numerics import Array

LAG_S = 1.0 / 12.0
"""Time constant of each lag: the base of the practice datasets to within its encoder's noise."""


@dataclass(frozen=True)
class Motion:
    """One motion of the base: what it is called, when it starts, where from, where to, how fast."""

    name: str
    start_s: float
    from_rad: float
    to_rad: float
    speed_rad_s: float
    settle_s: float

    @property
    def end_s(self) -> float:
        """When it has turned and settled."""
        return self.start_s + abs(self.to_rad - self.from_rad) / self.speed_rad_s + self.settle_s


def base_path(motions: tuple[Motion, ...], time_s: Array, lag_s: float = LAG_S) -> Array:
    """Angle of the base at `time_s` (samples,): no overshoot, no steady error.

    Response of 1/(1 + s·lag)² to the ramps, each motion's added to the remains of those before.
    """
    angle = np.full(len(time_s), motions[0].from_rad if motions else 0.0, dtype=np.float64)
    for motion in motions:
        turn = motion.to_rad - motion.from_rad
        if turn == 0.0:
            continue
        since = time_s - motion.start_s
        ramp_s = abs(turn) / motion.speed_rad_s
        angle += np.copysign(motion.speed_rad_s, turn) * (_ramp(since, lag_s) - _ramp(since - ramp_s, lag_s))
    return angle


def phases(motions: tuple[Motion, ...], time_s: Array) -> npt.NDArray[np.str_]:
    """Name of the motion at each sample, `rest` before the first."""
    starts = np.array([m.start_s for m in motions])
    names = np.array(["rest", *(m.name for m in motions)])
    return names[np.searchsorted(starts, time_s + 1e-9, side="right")]


def _ramp(time_s: Array, lag_s: float) -> Array:
    """Response to the unit ramp that starts at 0."""
    t = np.maximum(time_s, 0.0)
    return t - 2.0 * lag_s + (t + 2.0 * lag_s) * np.exp(-t / lag_s)
