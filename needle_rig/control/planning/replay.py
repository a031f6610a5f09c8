"""A model taken through the settled motions of a run: what it does where the rig's base has been."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from needle_rig.control.strategy import History, Task
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.settled_needle import SettledNeedle, Truth

READ_BEFORE_END_S = 0.25
"""Torques are means over the last half second: its middle stands for them."""
READ = slice(-2, -1)
"""The sample of every motion's path that stands for the sensors' window."""


def replayed(
    start: SettledNeedle, task: Task, history: History, truth: Truth = NeedleModel.truth
) -> list[SettledNeedle]:
    """The needle after each of the settled motions in `history`, the first of which is `start` at rest.

    Raises what `truth` raises.
    """
    needles = [start]
    for before, motion in pairwise(history):
        turn = abs(motion.base_angle_rad - before.base_angle_rad)
        held = motion.time_s - motion.moved_s
        arrive = min(max(turn / task.speed_rad_s, 1e-3), 0.9 * held)
        read = max(held - READ_BEFORE_END_S, 0.5 * (arrive + held))
        path = Trial(
            motion.moved_s + np.array([0.0, arrive, read, held]),
            np.array([before.base_angle_rad, *(motion.base_angle_rad,) * 3]),
        )
        needles.append(needles[-1].moved(path, truth))
    return needles
