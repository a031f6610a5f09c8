"""Rods that depend on no rate: one implicit step a sample is exact, none is needed while the base stands."""

from __future__ import annotations

import numpy as np

from needle_rig.physics.kernel._compile import compiled, copy_state
from needle_rig.physics.kernel.dense_output import store_sample
from needle_rig.physics.kernel.layout import (
    ANCHOR,
    DONE,
    FAILED_SAMPLE,
    NO_SOLUTION,
    SOLVES,
    TOO_MANY_SOLVES,
)
from needle_rig.physics.kernel.step import implicit_step, predict_active_set, set_step_length


@compiled
def reach_first_sample(rod, settings, has, laws, drive, sensors, states, work, output, counts):
    """Turn the base to its first angle, where the start has another, as within one sample; store the sample.

    Every slot of `states` holds the start; slot 0 holds the first sample afterwards. False: no solution.
    """
    times, base = drive.time_s, drive.base_rad
    now, before, row = np.intp(0), np.intp(1), np.intp(0)
    if base[0] != states[now, ANCHOR, 0]:
        dt = times[1] - times[0] if times.size > 1 else 1e-3
        set_step_length(rod, has, dt, work)
        if not implicit_step(
            rod, settings, has, laws, states, before, now, before, dt, base[0], times[0], work, counts
        ):
            return False
    store_sample(rod, has, laws, states, now, times[0], row, sensors, output, work)
    return True


@compiled
def follow_quasi_static(rod, settings, has, laws, drive, sensors, states, work, output, counts):
    """Follow the base path from slot 0 of `states`; slot 1 holds the state before it. Returns how it ended.

    The last state ends up in slot 0.
    """
    times, base = drive.time_s, drive.base_rad
    now, before, new = np.intp(0), np.intp(1), np.intp(2)
    turned = base[0] - states[before, ANCHOR, 0]
    # torque laws move the needle at a base that stands still, once
    at_rest = not has.laws or turned != 0.0
    for row in range(1, times.size):
        if counts[SOLVES] > settings.most_solves:
            counts[FAILED_SAMPLE] = row - 1
            return TOO_MANY_SOLVES
        turn = base[row] - states[now, ANCHOR, 0]
        if turn != 0.0 or not at_rest:
            predict_active_set(states, before, now, turn / turned if turned != 0.0 else 0.0, new)
            dt = times[row] - times[row - 1]
            if not implicit_step(
                rod, settings, has, laws, states, now, new, now, dt, base[row], times[row], work, counts
            ):
                counts[FAILED_SAMPLE] = row - 1
                return NO_SOLUTION
            turned = turn
            at_rest = True
            before, now, new = now, new, before
        store_sample(rod, has, laws, states, now, times[row], row, sensors, output, work)
    copy_state(states, now)
    return DONE
