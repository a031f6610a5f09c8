"""Rods whose slip limits have a memory: implicit Euler steps, extrapolated.

Two half steps and a full one are taken, and their difference, the error of first order, is taken out
(Richardson extrapolation) and sets the length of the steps. A second stage that sets out from a predicted
state would change what dry friction remembers, as SDIRK2 does.
"""

from __future__ import annotations

import math

import numpy as np

from needle_rig.physics.kernel._compile import compiled, copy, copy_state, vectorised_maximum
from needle_rig.physics.kernel.dense_output import interpolates_off_middle, store_inside, store_sample
from needle_rig.physics.kernel.layout import (
    AGE,
    AGEING,
    ANGLE,
    DONE,
    EXCESS_STATE,
    FAILED_SAMPLE,
    NO_SOLUTION,
    SOLVES,
    SPRING,
    STATUS,
    TOO_MANY_SOLVES,
)
from needle_rig.physics.kernel.slip_limits import set_limits
from needle_rig.physics.kernel.step import (
    LIMIT_TOLERANCE,
    implicit_step,
    predict_active_set,
    project,
    set_step_length,
)
from needle_rig.physics.kernel.step_length import (
    choose_step,
    drive_angle,
    embedded_error,
    end_of_segment,
    growth_by_error,
    growth_by_interpolation,
)

MOST_GROWTH = 3.0
CUBIC = 1.0 / (12.0 * math.sqrt(3.0))
"""Largest value of |x (x − 1/2) (x − 1)| for x from 0 to 1."""


@compiled
def halves_and_whole(
    rod, settings, has, laws, drive, states, slots, row, time, dt, gap, stop, end_base, work, counts
):
    """Two half steps over `middle` to `end`, and a step of length dt to `whole`; False: no solution.

    `gap` is the time from the middle of the step before to `time`, negative where the base path bends there.
    """
    now, middle_before, middle, whole, end = slots
    h = 0.5 * dt
    set_step_length(rod, has, h, work)
    middle_base = drive_angle(drive, row, time + h)
    # `end` is still the start of the step before: longer ago is better, as fronts are known to the node only
    predict_active_set(states, end, now, 0.5 * h / gap, middle)
    if not implicit_step(
        rod, settings, has, laws, states, now, middle, now, h, middle_base, time + h, work, counts
    ):
        return False
    rest = dt - h
    if gap > 0.0:
        predict_active_set(states, middle_before, middle, rest / (gap + h), end)
    else:
        predict_active_set(states, now, middle, rest / h, end)
    if not implicit_step(
        rod, settings, has, laws, states, middle, end, middle, h, end_base, stop, work, counts
    ):
        return False
    # the active set at the end of the halves is a good first guess for the whole
    set_step_length(rod, has, dt, work)
    copy(states[end, STATUS], states[whole, STATUS])
    return implicit_step(rod, settings, has, laws, states, now, whole, end, dt, end_base, stop, work, counts)


@compiled
def extrapolate(rod, settings, has, states, middle, end, whole):
    """Take the error of first order out of the states in the middle and at the end."""
    n = states.shape[2]
    for r in range(3 if has.creep else 2):
        for i in range(n):
            states[middle, r, i] += 0.5 * (states[end, r, i] - states[whole, r, i])
        for i in range(n):
            states[end, r, i] += states[end, r, i] - states[whole, r, i]
    for i in range(n):
        excess = 2.0 * states[end, EXCESS_STATE, i] - states[whole, EXCESS_STATE, i]
        states[end, EXCESS_STATE, i] = min(1.0, max(0.0, excess))
        # other ages are not set by steps: rounding would double each time
        if rod[AGEING, i] > 0.0:
            # of the logarithm, to which the limit is proportional
            rest = settings.ageing_time_s
            grown = (rest + states[end, AGE, i]) ** 2 / (rest + states[whole, AGE, i])
            states[end, AGE, i] = max(0.0, grown - rest)


@vectorised_maximum
def dense_output_error(states, before, now, middle, end, gap, dt):
    """Largest error of the quadratic through a step, from the next divided difference.

    `before` is the state a time `gap` before `now`.
    """
    w_before = 1.0 / (gap * (gap + 0.5 * dt) * (gap + dt))
    w_now = -2.0 / (gap * dt * dt)
    w_middle = 4.0 / (dt * dt * (gap + 0.5 * dt))
    w_end = -2.0 / (dt * dt * (gap + dt))
    largest = 0.0
    for i in range(states.shape[2]):
        third = w_before * states[before, ANGLE, i] + w_now * states[now, ANGLE, i]
        third += w_middle * states[middle, ANGLE, i] + w_end * states[end, ANGLE, i]
        largest = max(largest, abs(third))
    return largest * CUBIC * dt**3


@compiled
def follow_extrapolated(rod, settings, has, laws, drive, sensors, states, work, output, counts):
    """Follow the base path from slot 0 of `states`. Returns how it ended; the last state ends up in slot 0.

    Steps end at samples, or divide the way to the next one; samples inside a step are read off a quadratic,
    whose error counts too.
    """
    times, base = drive.time_s, drive.base_rad
    tolerance = settings.tolerance_rad
    # steps that divide the way to a sample are longer by rounding
    shortest = settings.shortest_step_s * (1.0 + 1e-6)
    now, middle_before, middle = np.intp(0), np.intp(1), np.intp(2)
    end, whole, inside = np.intp(3), np.intp(4), np.intp(5)
    row, kink = np.intp(0), np.intp(0)
    time, gap = times[0], -1.0
    length = min(settings.longest_step_s, 1e-3)
    while row < times.size - 1:
        if counts[SOLVES] > settings.most_solves_per_sample * times.size:
            counts[FAILED_SAMPLE] = row
            return TOO_MANY_SOLVES
        if row >= kink:
            kink = end_of_segment(drive, row)
            gap = -1.0
            length = min(length, times[row + 1] - times[row])
        turn_rate = abs(base[row + 1] - base[row]) / (times[row + 1] - times[row])
        length = min(length, settings.longest_slip_rad / (turn_rate + 1e-12))
        target, stop, dt, end_base = choose_step(drive, has, time, length, row, kink, gap > 0.0, tolerance)
        slots = (now, middle_before, middle, whole, end)
        if not halves_and_whole(
            rod, settings, has, laws, drive, states, slots, row, time, dt, gap, stop, end_base, work, counts
        ):
            if dt <= shortest:
                counts[FAILED_SAMPLE] = row
                return NO_SOLUTION
            length = 0.5 * dt
            continue
        error = embedded_error(states, end, whole, work[SPRING, 0] / settings.torque_scale, tolerance)
        if error > 1.0 and dt > shortest:
            length = max(settings.shortest_step_s, dt * max(0.2, growth_by_error(error)))
            continue
        extrapolate(rod, settings, has, states, middle, end, whole)
        growth = min(MOST_GROWTH, growth_by_error(error))
        if target > row + 1 and gap > 0.0:
            missed = dense_output_error(states, middle_before, now, middle, end, gap, dt) / tolerance
            if missed > 1.0 and interpolates_off_middle(drive, row, target, time + 0.5 * dt, dt):
                length = dt * max(0.25, growth_by_interpolation(missed))
                continue
            growth = min(growth, max(1.0, growth_by_interpolation(missed)))
        if has.dry:
            set_limits(rod, settings, states, end, end, 1.0 + LIMIT_TOLERANCE, work)
            if not project(rod, has, laws, states, end, middle, 0.5 * dt, stop, work, counts):
                if dt <= shortest:
                    counts[FAILED_SAMPLE] = row
                    return NO_SOLUTION
                length = 0.5 * dt
                continue
            if target > row + 1:
                set_limits(rod, settings, states, now, end, 1.0 + LIMIT_TOLERANCE, work)
        if not store_inside(
            rod, has, laws, drive, states, now, middle, end, inside,
            time, dt, row, target, sensors, output, work, counts,
        ):  # fmt: skip
            return NO_SOLUTION
        gap = dt - 0.5 * dt
        middle_before, middle = middle, middle_before
        now, end = end, now
        length = max(settings.shortest_step_s, min(settings.longest_step_s, dt * growth))
        if target > row:
            store_sample(rod, has, laws, states, now, stop, target, sensors, output, work)
        row = target
        time = stop
    copy_state(states, now)
    return DONE
