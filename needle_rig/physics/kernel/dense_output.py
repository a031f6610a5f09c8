"""Samples: those at which steps end, and those inside, off the quadratic through a step's three states."""

from __future__ import annotations

from needle_rig.physics.kernel._compile import compiled
from needle_rig.physics.kernel.laws import call_law
from needle_rig.physics.kernel.layout import ANGLE, FAILED_SAMPLE, PLAY_TORQUE, POSITION, SPRING
from needle_rig.physics.kernel.step import project


@compiled
def store_sample(rod, has, laws, states, slot, time, row, sensors, output, work):
    """Write one sample: the torque that the base exerts on the needle, and angles."""
    torque = work[SPRING, 0] * (states[slot, ANGLE, 0] - states[slot, ANGLE, 1]) + work[PLAY_TORQUE, 0]
    if has.laws:
        for k in range(laws.addresses.size):
            if laws.weights_m[k, 0] != 0.0:
                torque -= laws.weights_m[k, 0] * call_law(
                    laws.addresses[k], laws.parameters[k], states[slot, ANGLE, 0], 0.0, time, rod[POSITION, 0]
                )
    output.torque_nm[row] = torque
    for s in range(sensors.size):
        output.sensor_rad[row, s] = states[slot, ANGLE, sensors[s]]
    output.tip_rad[row] = states[slot, ANGLE, states.shape[2] - 1]
    if output.shaft_rad.shape[0] > 0:
        for i in range(states.shape[2]):
            output.shaft_rad[row, i] = states[slot, ANGLE, i]


@compiled
def interpolate(states, now, middle, end, x, rows, out):
    """The first `rows` rows of a state at the fraction x of a step, on the quadratic through the step."""
    w0, w1, w2 = (2.0 * x - 1.0) * (x - 1.0), 4.0 * x * (1.0 - x), x * (2.0 * x - 1.0)
    for r in range(rows):
        for i in range(states.shape[2]):
            ends = w0 * states[now, r, i] + w2 * states[end, r, i]
            states[out, r, i] = ends + w1 * states[middle, r, i]


@compiled
def store_inside(
    rod, has, laws, drive, states, now, middle, end, out, time, dt, row, target, sensors, output, work, counts
):
    """Write the samples between `row` and `target`, inside a step of length dt; False: one was not found."""
    for k in range(row + 1, target):
        x = (drive.time_s[k] - time) / dt
        interpolate(states, now, middle, end, x, 3 if has.dry else 1, out)
        if has.dry and not project(rod, has, laws, states, out, now, x * dt, drive.time_s[k], work, counts):
            counts[FAILED_SAMPLE] = k
            return False
        store_sample(rod, has, laws, states, out, drive.time_s[k], k, sensors, output, work)
    return True


@compiled
def interpolates_off_middle(drive, row, target, middle_time, dt):
    """Whether a sample between `row` and `target` lies elsewhere than in the middle of the step."""
    return target > row + 2 or abs(drive.time_s[row + 1] - middle_time) > 1e-6 * dt
