"""Rods that depend on rates: a singly diagonally implicit Runge–Kutta method of second order (SDIRK2).

Two implicit stages of length γ · dt with γ = 1 − 1/√2, L-stable and stiffly accurate (Alexander, SIAM J.
Numer. Anal. 14, 1977). What it adds to first order sets the length of the steps.
"""

from __future__ import annotations

import math

import numpy as np

from needle_rig.physics.kernel._compile import compiled, copy_state
from needle_rig.physics.kernel.dense_output import interpolates_off_middle, store_inside, store_sample
from needle_rig.physics.kernel.layout import (
    ANCHOR,
    ANGLE,
    DONE,
    FAILED_SAMPLE,
    NO_SOLUTION,
    SOLVES,
    SPRING,
    STATUS,
    TOO_MANY_SOLVES,
    VISCOUS,
)
from needle_rig.physics.kernel.step import implicit_step, predict_active_set, set_step_length
from needle_rig.physics.kernel.step_length import (
    TORQUE_PER_RAD,
    choose_step,
    drive_angle,
    embedded_error,
    end_of_segment,
    growth_by_error,
    growth_by_interpolation,
)

GAMMA = 1.0 - math.sqrt(0.5)
"""Length of each of the two stages of a step, as a part of it."""
STAGE_PREDICTOR = math.sqrt(0.5) / GAMMA
"""(1 − γ) / γ: the second stage sets out where the first gets when it goes on for so many times as long."""
MOST_GROWTH = 5.0


@compiled
def predict_second_stage(rod, has, states, now, stage, start):
    """The state `start` from which the second stage of a step sets out.

    What changes at a rate goes on as in the first stage; dry friction, which knows no rate, is followed.
    """
    for r in range(3 if has.creep else 2):
        for i in range(states.shape[2]):
            states[start, r, i] = states[now, r, i] + STAGE_PREDICTOR * (
                states[stage, r, i] - states[now, r, i]
            )
    for i in range(states.shape[2]):
        states[start, STATUS, i] = states[stage, STATUS, i]
    if has.dry:
        for i in range(states.shape[2]):
            states[start, ANCHOR, i] = states[start if rod[VISCOUS, i] > 0.0 else stage, ANCHOR, i]


@compiled
def embedded_solution(states, now, stage, middle, end, lower, rate, dt, rows):
    """After both stages: the rate at the end, the state in the middle, and `lower`, to compare with the end.

    The middle lies on the parabola with the rate at the end; `lower` lacks half of what the rate changed by.
    """
    for i in range(states.shape[2]):
        first = states[stage, ANGLE, i] - states[now, ANGLE, i]
        second = states[end, ANGLE, i] - states[now, ANGLE, i] - STAGE_PREDICTOR * first
        states[rate, ANGLE, i] = second / (GAMMA * dt)
        states[lower, ANGLE, i] = states[end, ANGLE, i] - 0.5 * (second - first)
        states[middle, STATUS, i] = states[stage, STATUS, i]
    for r in range(rows):
        for i in range(states.shape[2]):
            first = states[stage, r, i] - states[now, r, i]
            gone = states[end, r, i] - states[now, r, i]
            bent = 0.25 / GAMMA * (gone - STAGE_PREDICTOR * first)
            states[middle, r, i] = states[now, r, i] + (0.75 * gone - bent)


@compiled
def parabola_error(states, now, stage, rate_before, rate, dt, i):
    """Error at node i of the parabola through a step.

    1.5 times the distance of the rate in the first stage from the line between the rates at the ends bounds
    the error where a rate jumps, wherever in the step that is.
    """
    line = (1.0 - GAMMA) * states[rate_before, ANGLE, i] + GAMMA * states[rate, ANGLE, i]
    return 1.5 * (dt * line - (states[stage, ANGLE, i] - states[now, ANGLE, i]) / GAMMA)


@compiled
def dense_output_error(states, now, stage, rate_before, rate, dt, sensors, every_node, stiffness):
    """Largest error of the parabola at what is stored: sensors and tip or every node, and the base torque."""
    twist = parabola_error(states, now, stage, rate_before, rate, dt, np.intp(0))
    twist -= parabola_error(states, now, stage, rate_before, rate, dt, np.intp(1))
    largest = abs(twist) * stiffness / TORQUE_PER_RAD
    last = states.shape[2] - 1
    for k in range(last if every_node else sensors.size):
        node = k if every_node else sensors[k]
        largest = max(largest, abs(parabola_error(states, now, stage, rate_before, rate, dt, node)))
    return max(largest, abs(parabola_error(states, now, stage, rate_before, rate, dt, last)))


@compiled
def two_stages(
    rod, settings, has, laws, drive, states, slots, row, time, dt, gap, stop, end_base, work, counts
):
    """Both stages of a step of length dt; False: no solution.

    `gap` is the time from the middle of the step before to `time`, negative where the base path bends there.
    """
    now, middle_before, stage, lower, end = slots
    h = GAMMA * dt
    stage_base = drive_angle(drive, row, time + h)
    # `end` is still the start of the step before: longer ago is better, as fronts are known to the node only
    predict_active_set(states, end, now, (1.0 - GAMMA) * h / gap, stage)
    if not implicit_step(
        rod, settings, has, laws, states, now, stage, now, h, stage_base, time + h, work, counts
    ):
        return False
    predict_second_stage(rod, has, states, now, stage, lower)
    rest = dt - h
    if gap > 0.0:
        predict_active_set(states, middle_before, lower, rest / (gap + h), end)
    else:
        predict_active_set(states, now, lower, rest / h, end)
    return implicit_step(rod, settings, has, laws, states, lower, end, stage, h, end_base, stop, work, counts)


@compiled
def follow_sdirk(rod, settings, has, laws, drive, sensors, states, work, output, counts):
    """Follow the base path from slot 0 of `states`. Returns how it ended; the last state ends up in slot 0.

    Steps end at samples, or divide the way to the next one; samples inside a step are read off a parabola,
    whose error counts too.
    """
    times = drive.time_s
    tolerance = settings.tolerance_rad
    # steps that divide the way to a sample are longer by rounding
    shortest = settings.shortest_step_s * (1.0 + 1e-6)
    now, middle_before, middle, end = np.intp(0), np.intp(1), np.intp(2), np.intp(3)
    lower, stage, rate, rate_before = np.intp(4), np.intp(5), np.intp(6), np.intp(7)
    every_node = output.shaft_rad.shape[0] > 0
    row, kink = np.intp(0), np.intp(0)
    time, gap, coefficients_for = times[0], -1.0, -1.0
    length = min(settings.longest_step_s, 1e-3)
    while row < times.size - 1:
        if counts[SOLVES] > settings.most_solves_per_sample * times.size:
            counts[FAILED_SAMPLE] = row
            return TOO_MANY_SOLVES
        if row >= kink:
            kink = end_of_segment(drive, row)
            gap = -1.0
            length = min(length, times[row + 1] - times[row])
        target, stop, dt, end_base = choose_step(drive, has, time, length, row, kink, gap > 0.0, tolerance)
        if GAMMA * dt != coefficients_for:
            coefficients_for = GAMMA * dt
            set_step_length(rod, has, coefficients_for, work)
        slots = (now, middle_before, stage, lower, end)
        if not two_stages(
            rod, settings, has, laws, drive, states, slots, row, time, dt, gap, stop, end_base, work, counts
        ):
            if dt <= shortest:
                counts[FAILED_SAMPLE] = row
                return NO_SOLUTION
            length = 0.5 * dt
            continue
        embedded_solution(states, now, stage, middle, end, lower, rate, dt, 3 if has.dry else 1)
        error = embedded_error(states, end, lower, work[SPRING, 0] / settings.torque_scale, tolerance)
        if error > 1.0 and dt > shortest:
            length = max(settings.shortest_step_s, dt * max(0.2, growth_by_error(error)))
            continue
        growth = min(MOST_GROWTH, growth_by_error(error))
        if target > row + 1 and gap > 0.0:
            missed = dense_output_error(
                states,
                now,
                stage,
                rate_before,
                rate,
                dt,
                sensors,
                every_node,
                work[SPRING, 0] / settings.torque_scale,
            )
            missed /= tolerance
            if missed > 1.0 and interpolates_off_middle(drive, row, target, time + GAMMA * dt, dt):
                length = dt * max(0.25, growth_by_interpolation(missed))
                continue
            growth = min(growth, max(1.0, growth_by_interpolation(missed)))
        if target > row + 1:
            coefficients_for = -1.0
            if not store_inside(
                rod, has, laws, drive, states, now, middle, end, stage,
                time, dt, row, target, sensors, output, work, counts,
            ):  # fmt: skip
                return NO_SOLUTION
        gap = dt - GAMMA * dt
        middle_before, middle = middle, middle_before
        rate, rate_before = rate_before, rate
        now, end = end, now
        length = max(settings.shortest_step_s, min(settings.longest_step_s, dt * growth))
        if target > row:
            store_sample(rod, has, laws, states, now, stop, target, sensors, output, work)
        row = target
        time = stop
    copy_state(states, now)
    return DONE
