"""Rods that depend on no rate: one implicit step a sample is exact, none is needed while the base
stands and the torque on the tip stays."""

from __future__ import annotations

import numpy as np

from needle_rig.physics.kernel._compile import compiled, copy, copy_state
from needle_rig.physics.kernel.active_set import node_torque
from needle_rig.physics.kernel.dense_output import store_sample
from needle_rig.physics.kernel.layout import (
    ANCHOR,
    ANGLE,
    DONE,
    FAILED_SAMPLE,
    LIMIT_MINUS,
    LIMIT_PLUS,
    MINUS,
    NO_SOLUTION,
    PLUS,
    SOLVES,
    STATUS,
    TOO_MANY_SOLVES,
)
from needle_rig.physics.kernel.step import implicit_step, predict_active_set, set_step_length
from needle_rig.physics.kernel.tangent import follow_tangents, store_tangents

MOST_PIECES = 512
"""Of a step that has no solution in one."""


@compiled
def lower_limits(rod, states, start, share, work):
    """Slip limits the part `share` of the way from what the state `start` holds to the rod's."""
    last = states.shape[2] - 1
    for i in range(1, last + 1):
        torque = node_torque(states, start, work, i, states[start, ANGLE, min(i + 1, last)])
        work[LIMIT_PLUS, i] = rod[PLUS, i] + (1.0 - share) * max(0.0, torque - rod[PLUS, i])
        work[LIMIT_MINUS, i] = rod[MINUS, i] + (1.0 - share) * max(0.0, -torque - rod[MINUS, i])


@compiled
def step_in_pieces(rod, settings, has, laws, states, now, new, dt, start, end, stop, work, counts):
    """The step of length dt to the time `stop`, in shorter and shorter pieces, from `now` into `new`.

    The base turns from `start` to `end`. False: no solution.

    A base and a tip that are turned at once push slip fronts at each other, farther in a step than an active
    set may be guessed. A shaft that holds more than the slip limits, as friction fell since, slips nearly
    everywhere; its limits are lowered piece by piece too.
    """
    pieces = 1
    while pieces < MOST_PIECES:
        pieces *= 8
        one, other = np.intp(3), np.intp(4)
        for r in range(states.shape[1]):
            copy(states[now, r], states[one, r])
            copy(states[now, r], states[other, r])
        piece = dt / pieces
        set_step_length(rod, has, piece, work)
        done = 0
        for k in range(1, pieces + 1):
            share = k / pieces
            angle = end if k == pieces else start + share * (end - start)
            time = stop - (pieces - k) * piece
            copy(states[one, STATUS], states[other, STATUS])
            if not has.loaded:
                lower_limits(rod, states, now, share, work)
            if not implicit_step(
                rod, settings, has, laws, states, one, other, one, piece, angle, time, work, counts
            ):
                break
            one, other = other, one
            done = k
        if done == pieces:
            for r in range(states.shape[1]):
                copy(states[one, r], states[new, r])
            return True
    return False


@compiled
def reach_first_sample(rod, settings, has, laws, drive, sensors, states, work, output, tangents, counts):
    """Turn the base to its first angle, where the start has another, as within one sample; store the sample.

    A torque on the tip reaches its first value likewise.

    Every slot of `states` holds the start; slot 0 holds the first sample afterwards. False: no solution.
    """
    times, base = drive.time_s, drive.base_rad
    now, before, row = np.intp(0), np.intp(1), np.intp(0)
    if base[0] != states[now, ANCHOR, 0] or drive.tip_nm.size > 0:
        dt = times[1] - times[0] if times.size > 1 else 1e-3
        set_step_length(rod, has, dt, work)
        start = states[before, ANCHOR, 0]
        if not implicit_step(
            rod, settings, has, laws, states, before, now, before, dt, base[0], times[0], work, counts
        ) and not step_in_pieces(
            rod, settings, has, laws, states, before, now, dt, start, base[0], times[0], work, counts
        ):
            return False
        if tangents.ratio.size > 0:
            follow_tangents(states, now, work, tangents)
    store_sample(rod, has, laws, states, now, times[0], row, sensors, output, work)
    if tangents.ratio.size > 0:
        store_tangents(states, now, row, sensors, work, tangents)
    return True


@compiled
def follow_quasi_static(rod, settings, has, laws, drive, sensors, states, work, output, tangents, counts):
    """Follow the base path from slot 0 of `states`; slot 1 holds the state before it. Returns how it ended.

    The last state ends up in slot 0.
    """
    times, base, tip = drive.time_s, drive.base_rad, drive.tip_nm
    now, before, new = np.intp(0), np.intp(1), np.intp(2)
    turned = base[0] - states[before, ANCHOR, 0]
    # torque laws move the needle at a base that stands still, once
    at_rest = not has.laws or turned != 0.0
    for row in range(1, times.size):
        if counts[SOLVES] > settings.most_solves_per_sample * times.size:
            counts[FAILED_SAMPLE] = row - 1
            return TOO_MANY_SOLVES
        turn = base[row] - states[now, ANCHOR, 0]
        loaded = tip.size > 0 and tip[row] != tip[row - 1]
        if turn != 0.0 or loaded or not at_rest:
            predict_active_set(states, before, now, turn / turned if turned != 0.0 else 0.0, new)
            dt = times[row] - times[row - 1]
            start = states[now, ANCHOR, 0]
            if not implicit_step(
                rod, settings, has, laws, states, now, new, now, dt, base[row], times[row], work, counts
            ) and not step_in_pieces(
                rod, settings, has, laws, states, now, new, dt, start, base[row], times[row], work, counts
            ):
                counts[FAILED_SAMPLE] = row - 1
                return NO_SOLUTION
            turned = turn
            at_rest = True
            before, now, new = now, new, before
            if tangents.ratio.size > 0:
                follow_tangents(states, now, work, tangents)
        store_sample(rod, has, laws, states, now, times[row], row, sensors, output, work)
        if tangents.ratio.size > 0:
            store_tangents(states, now, row, sensors, work, tangents)
    copy_state(states, now)
    return DONE
