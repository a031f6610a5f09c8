"""What a solver is given and what it gives back: paths of the base, states and readings of a rod."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.numerics import Array


@dataclass(frozen=True, eq=False)
class RodState:
    """Everything a rod remembers; arrays of shape (nodes,)."""

    angle_rad: Array
    anchor_rad: Array
    """Plastic anchor: where the tissue holds the node; of the base node the turned base."""
    creep_rad: Array
    excess_state: Array
    """State variable of the static excess, 0 to 1."""
    age_s: Array
    slip: Array
    """Direction of slip of the last step, −1, 0 or 1; 2 where nothing resists a turn."""


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solved rod did at `time_s` (samples,)."""

    time_s: Array
    torque_nm: Array
    """Torque that the base exerts on the needle, shape (samples,)."""
    sensor_rad: Array
    """Shape (samples, sensors)."""
    tip_rad: Array
    shaft_rad: Array | None
    """Angle of every node, shape (samples, nodes), when asked for."""
    state: RodState
    """At the last sample; give it to `solve` to go on."""
    steps: int
    solves: int


@dataclass(frozen=True, eq=False)
class Path:
    """How a base is turned: times, base angles and torques on the tip (samples,), checked.

    `tip_nm` is empty where nothing acts on the tip.
    """

    time_s: Array
    base_rad: Array
    tip_nm: Array

    @classmethod
    def of(cls, time_s: Array, base_angle_rad: Array, tip_torque_nm: Array | None = None) -> Path:
        """Raises BadInput where the rows differ in length, are not finite, or time does not increase."""
        time = np.ascontiguousarray(time_s, dtype=np.float64)
        base = np.ascontiguousarray(base_angle_rad, dtype=np.float64)
        tip = np.ascontiguousarray(np.empty(0) if tip_torque_nm is None else tip_torque_nm, dtype=np.float64)
        if time.ndim != 1 or time.shape != base.shape:
            raise BadInput(
                f"times {time.shape} and base angles {base.shape} must be two rows of the same length"
            )
        if tip_torque_nm is not None and tip.shape != time.shape:
            raise BadInput(
                f"times {time.shape} and torques on the tip {tip.shape} must be rows of the same length"
            )
        if time.size == 0:
            raise BadInput("the trajectory is empty; give at least the starting time and base angle")
        for name, values in (("time", time), ("base angle", base), ("tip torque", tip)):
            finite = np.isfinite(values)
            if not finite.all():
                sample = int(np.argmin(finite))
                raise BadInput(f"{name} is {values[sample]} at sample {sample}; it must be a finite number")
        if time.size > 1 and not (np.diff(time) > 0).all():
            sample = int(np.argmin(np.diff(time) > 0)) + 1
            raise BadInput(
                f"time goes from {time[sample - 1]:g} to {time[sample]:g} s at sample {sample};"
                " times must increase from sample to sample"
            )
        return cls(time, base, tip)


@dataclass(frozen=True, eq=False)
class Sampled:
    """What the base and the sensors of a solved rod did: (samples,), (samples, sensors), and its solves."""

    torque_nm: Array
    sensor_rad: Array
    solves: int
