"""Elements with play: three pieces of a spring, slack and pushed one way or the other."""

from __future__ import annotations

import math

from needle_rig.physics.kernel._compile import compiled
from needle_rig.physics.kernel.layout import (
    ANGLE,
    EPS,
    FORCE,
    PLAY,
    PLAY_SIDE,
    PLAY_TORQUE,
    SLACK,
    SPRING,
    STIFFNESS,
)


@compiled
def set_side(rod, work, i, side):
    """Let element i be inside its play (0) or pushed to one side of it (±1)."""
    tangent, constant = rod[SLACK, i] * work[STIFFNESS, i], 0.0
    if side != 0.0:
        tangent = work[STIFFNESS, i]
        constant = (rod[SLACK, i] - 1.0) * tangent * 0.5 * rod[PLAY, i] * side
    work[FORCE, i] += work[PLAY_TORQUE, i] - constant
    work[FORCE, i + 1] += constant - work[PLAY_TORQUE, i]
    work[SPRING, i], work[PLAY_TORQUE, i], work[PLAY_SIDE, i] = tangent, constant, side


@compiled
def side_of(rod, states, slot, work, i):
    """On which side of its play element i is in the solution; near an edge it stays where it is."""
    twist, half, side = (
        states[slot, ANGLE, i] - states[slot, ANGLE, i + 1],
        0.5 * rod[PLAY, i],
        work[PLAY_SIDE, i],
    )
    rounding = 64.0 * EPS * (abs(states[slot, ANGLE, i]) + half)
    if side == 0.0:
        return math.copysign(1.0, twist) if abs(twist) > half + rounding else 0.0
    return side if side * twist > half - rounding else (-side if -side * twist > half + rounding else 0.0)


@compiled
def start_sides(rod, states, slot, work):
    """Sides of the plays for the angles of a state."""
    for i in range(states.shape[2] - 1):
        if rod[PLAY, i] > 0.0:
            set_side(rod, work, i, side_of(rod, states, slot, work, i))


@compiled
def count_wrong_sides(rod, states, slot, work):
    """How many elements with play are on another side in the solution than they were taken to be."""
    count = 0
    for i in range(states.shape[2] - 1):
        if rod[PLAY, i] > 0.0 and side_of(rod, states, slot, work, i) != work[PLAY_SIDE, i]:
            count += 1
    return count


@compiled
def correct_sides(rod, states, slot, work, most):
    """Move wrong elements, at most so many, by one step towards the side on which they are."""
    for i in range(states.shape[2] - 1):
        if rod[PLAY, i] > 0.0 and most > 0:
            side = side_of(rod, states, slot, work, i)
            if side != work[PLAY_SIDE, i]:
                set_side(rod, work, i, side if side * work[PLAY_SIDE, i] >= 0.0 else 0.0)
                most -= 1
