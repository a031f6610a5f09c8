"""The length of the steps: how far one may reach along the base path, and what its error says of the next."""

from __future__ import annotations

import math

from needle_rig.physics.kernel._compile import compiled, vectorised_maximum
from needle_rig.physics.kernel.layout import ANGLE

TORQUE_PER_RAD = 5e-4
"""Error of the base torque (N·m) that counts as much as one radian of error in an angle."""
KINK_RAD = 1e-9
"""A sample this close to a straight line lies on it."""


@compiled
def drive_angle(drive, row, time):
    """Base angle at `time`, which does not lie before sample `row`."""
    times, base = drive.time_s, drive.base_rad
    while times[row + 1] < time:
        row += 1
    fraction = (time - times[row]) / (times[row + 1] - times[row])
    return base[row] + fraction * (base[row + 1] - base[row])


@compiled
def end_of_segment(drive, row):
    """The sample at which the straight line that starts at sample `row` ends, of base path or tip torque."""
    times, base, tip = drive.time_s, drive.base_rad, drive.tip_nm
    if tip.size > 0 and tip[row + 1] != tip[row]:
        return row + 1
    rate = (base[row + 1] - base[row]) / (times[row + 1] - times[row])
    end = row + 1
    while end < times.size - 1:
        dt = times[end + 1] - times[end]
        if abs((base[end + 1] - base[end]) / dt - rate) * dt > KINK_RAD:
            break
        if tip.size > 0 and tip[end + 1] != tip[end]:
            break
        end += 1
    return end


@compiled
def last_sample_within(drive, has, time, length, row, kink, interpolates, tolerance_rad):
    """Row of the last sample that a step of `length` from `time` may reach.

    The base path bends at row `kink`.

    While the base moves a sensor that dry friction holds can start or stop between two samples, so that no
    sample may lie inside a step then, save in its middle, where a half step ends.
    """
    times, base = drive.time_s, drive.base_rad
    dry = has.dry or has.memory
    target = row + 1
    while target < kink and times[target + 1] - time <= length * (1.0 + 1e-9):
        still = abs(base[target + 1] - base[row]) <= 10.0 * tolerance_rad
        if not interpolates or (dry and not still):
            middle = abs(times[row + 2] + time - 2.0 * times[row + 1]) <= 1e-6 * length
            if has.memory and target == row + 1 and middle:
                target += 1
            break
        target += 1
    return target


@compiled
def choose_step(drive, has, time, length, row, kink, interpolates, tolerance_rad):
    """Target sample, end, length and base angle at the end of a step of about `length` that begins at `time`.

    It ends at a sample or divides the way to the next one, in which case the target is `row` itself.
    """
    to_next = drive.time_s[row + 1] - time
    if length >= to_next * (1.0 - 1e-9):
        target = last_sample_within(drive, has, time, length, row, kink, interpolates, tolerance_rad)
        stop = drive.time_s[target]
        return target, stop, stop - time, drive.base_rad[target]
    dt = to_next / math.ceil(to_next / length - 1e-9)
    stop = time + dt
    return row, stop, dt, drive_angle(drive, row, stop)


@vectorised_maximum
def largest_difference(states, a, b):
    """Largest difference of angles between two states."""
    largest = 0.0
    for i in range(states.shape[2]):
        largest = max(largest, abs(states[a, ANGLE, i] - states[b, ANGLE, i]))
    return largest


@compiled
def embedded_error(states, end, lower, stiffness, tolerance_rad):
    """Difference of two solutions of the same step, of angles and base torque, in tolerances."""
    twist = states[end, ANGLE, 0] - states[end, ANGLE, 1]
    twist -= states[lower, ANGLE, 0] - states[lower, ANGLE, 1]
    return (
        max(largest_difference(states, end, lower), abs(twist) * stiffness / TORQUE_PER_RAD) / tolerance_rad
    )


@compiled
def growth_by_interpolation(error):
    """By what to multiply the length of a step whose dense output, of third order, has `error` tolerances."""
    return 0.85 / max(error, 1e-4) ** (1.0 / 3.0)


@compiled
def growth_by_error(error):
    """By what to multiply the length of a step, of second order, whose error is `error` tolerances."""
    return 0.85 / math.sqrt(max(error, 1e-4))
