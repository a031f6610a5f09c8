"""Slip limits that change: with the torque that the rod carries, and with a memory, as `Rod` has them."""

from __future__ import annotations

import math

from needle_rig.physics.kernel._compile import compiled
from needle_rig.physics.kernel.layout import (
    AGE,
    AGEING,
    ALGORITHMIC,
    ANGLE,
    DAMPING,
    EXCESS,
    EXCESS_STATE,
    FACTOR,
    FACTOR_EXPECTED,
    FALL,
    FALL_EXPECTED,
    FORCE,
    KINETIC_MINUS,
    KINETIC_PLUS,
    LIMIT_MINUS,
    LIMIT_PLUS,
    MINUS,
    PER_TORQUE,
    PLAY_TORQUE,
    PLUS,
    SLIP,
    SLIP_EXPECTED,
    SLOPE,
    SPRING,
    VISCOUS,
)

PER_DECADE = 1.0 / math.log(10.0)


@compiled
def follow_load(rod, states, slot, work):
    """Kinetic slip limits for the torque that the rod carries on both sides of a node; their largest change.

    The change is relative to the limit.
    """
    last = states.shape[2] - 1
    largest = 0.0
    before = abs(work[SPRING, 0] * (states[slot, ANGLE, 0] - states[slot, ANGLE, 1]))
    for i in range(1, last + 1):
        if i < last:
            twist = states[slot, ANGLE, i] - states[slot, ANGLE, i + 1]
            after = abs(work[SPRING, i] * twist + work[PLAY_TORQUE, i])
        else:
            outside = work[FORCE, i] + work[SLOPE, i] * states[slot, ANGLE, i]
            after = abs(outside - work[PLAY_TORQUE, i - 1])
        if rod[PER_TORQUE, i] > 0.0:
            added = 0.5 * rod[PER_TORQUE, i] * (before + after)
            change = abs(rod[PLUS, i] + added - work[KINETIC_PLUS, i])
            work[KINETIC_PLUS, i] = rod[PLUS, i] + added
            work[KINETIC_MINUS, i] = rod[MINUS, i] + added
            largest = max(largest, change / (work[KINETIC_PLUS, i] + 1e-300))
        before = after
    return largest


@compiled
def set_limits(rod, settings, states, one, other, slack, work):
    """Slip limits, times `slack`, for the excess and age of the states `one` or `other`, the higher ones."""
    for i in range(states.shape[2]):
        factor = 1.0 + rod[EXCESS, i] * max(states[one, EXCESS_STATE, i], states[other, EXCESS_STATE, i])
        if rod[AGEING, i] > 0.0:
            age = max(states[one, AGE, i], states[other, AGE, i])
            factor += rod[AGEING, i] * PER_DECADE * math.log(1.0 + age / settings.ageing_time_s)
        factor *= slack
        work[LIMIT_PLUS, i] = work[KINETIC_PLUS, i] * factor
        work[LIMIT_MINUS, i] = work[KINETIC_MINUS, i] * factor


@compiled
def follow_memory(rod, settings, states, old, new, dt, work):
    """Excess state and age after an implicit Euler step with slip SLIP; FACTOR of the limits and its FALL.

    Returns the largest error of a factor that was expected.
    """
    rate, weakening, rest = settings.stribeck_rate_rad_s, settings.weakening_rad, settings.ageing_time_s
    exponent = settings.stribeck_exponent
    gaussian = exponent == 2.0
    largest = 0.0
    for i in range(1, states.shape[2]):
        slip = abs(work[SLIP, i])
        factor, fall = 1.0, 0.0
        if rod[EXCESS, i] > 0.0:
            ratio = slip / (dt * rate)
            gain = (slip + dt * rate) / weakening
            # a power costs half as much again as all the rest
            power = ratio * ratio if gaussian else ratio**exponent
            steep = 2.0 * ratio if gaussian else exponent * ratio ** (exponent - 1.0)
            target = math.exp(-power)
            excess = (states[old, EXCESS_STATE, i] + gain * target) / (1.0 + gain)
            slope = (target - excess) / weakening - steep * gain * target / (dt * rate)
            factor += rod[EXCESS, i] * excess
            fall += rod[EXCESS, i] * slope / (1.0 + gain)
            states[new, EXCESS_STATE, i] = excess
        if rod[AGEING, i] > 0.0:
            age = (states[old, AGE, i] + dt) * weakening / (weakening + slip)
            factor += rod[AGEING, i] * PER_DECADE * math.log(1.0 + age / rest)
            fall -= rod[AGEING, i] * PER_DECADE * age / ((weakening + slip) * (rest + age))
            states[new, AGE, i] = age
        work[FACTOR, i], work[FALL, i] = factor, fall
        error = abs(factor - work[FACTOR_EXPECTED, i] - work[FALL_EXPECTED, i] * slip)
        # a fall expected in one direction says nothing of the other
        largest = max(largest, error if work[SLIP, i] * work[SLIP_EXPECTED, i] >= 0.0 else 1.0)
    return largest


@compiled
def linearise_limits(rod, dt, newton, work):
    """Set the slip limits to FACTOR; by Newton's method falling with the slip, a viscosity below zero."""
    for i in range(1, rod.shape[1]):
        slip = work[SLIP, i]
        damping, fall = rod[VISCOUS, i] / dt, 0.0
        steep = work[FALL, i] * (work[KINETIC_PLUS, i] if slip > 0.0 else work[KINETIC_MINUS, i])
        # tissue whose limit falls faster than it unloads snaps: no slope to go by
        if newton and slip != 0.0 and 1.0 + work[ALGORITHMIC, i] * (damping + steep) > 0.5:
            damping, fall = damping + steep, work[FALL, i]
        factor = work[FACTOR, i] - fall * abs(slip)
        work[FACTOR_EXPECTED, i], work[FALL_EXPECTED, i], work[SLIP_EXPECTED, i] = factor, fall, slip
        work[LIMIT_PLUS, i] = work[KINETIC_PLUS, i] * factor
        work[LIMIT_MINUS, i] = work[KINETIC_MINUS, i] * factor
        work[DAMPING, i] = damping / (1.0 + work[ALGORITHMIC, i] * damping)
