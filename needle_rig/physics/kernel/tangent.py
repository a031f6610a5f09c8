"""The tangent of a quasi-static step along changes of the rod's coefficients (implicit function theorem).

In a solved step the active set is known: a change of coefficients changes the angles by the solution of the
same linear system with another right-hand side. No hook of an effect has to know derivatives: the changes are
differences of two rods' arrays.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from needle_rig.physics.kernel._compile import compiled
from needle_rig.physics.kernel.layout import (
    ALGORITHMIC,
    ANGLE,
    FORCE,
    FREE,
    LIMIT_MINUS,
    LIMIT_PLUS,
    SPRING,
    STATUS,
    STUCK,
)

# rows of `changes`, and of the rods of `Neighbours`
SPRING_CHANGE, PLUS_CHANGE, MINUS_CHANGE, COMPLIANCE_CHANGE = range(4)
# rows of `of_state`; the last holds right-hand sides
ANGLE_CHANGE, ANCHOR_CHANGE, RIGHT = range(3)


class Neighbours(NamedTuple):
    """Rods near the one that is followed, and what they would do: D neighbours, T trials, N samples."""

    rods: Any
    """Springs, slip limits in both directions and compliances (4, nodes, D)."""
    friction_factor: Any
    """(T, D)"""
    torque_change_nm: Any
    """(N, D)"""
    sensor_change_rad: Any
    """(N, sensors, D)"""


class Tangents(NamedTuple):
    """Neighbours of one trial."""

    changes: Any
    """Of coefficients (4, nodes, D)."""
    of_state: Any
    """Of angles and anchors (3, nodes, D)."""
    ratio: Any
    """(nodes,) of the elimination."""
    torque_change_nm: Any
    sensor_change_rad: Any


@compiled
def begin_tangents(tangents, rods, factors, factor, rod_plus, rod_minus, work):
    """Write the changes of coefficients into `tangents`, and none of the state; nothing is returned.

    The limits of `rod_plus` and `rod_minus` hold at `factor`.
    """
    changes = tangents.changes
    for i in range(changes.shape[1]):
        for d in range(changes.shape[2]):
            changes[SPRING_CHANGE, i, d] = rods[SPRING_CHANGE, i, d] - work[SPRING, i]
            changes[PLUS_CHANGE, i, d] = rods[PLUS_CHANGE, i, d] * factors[d] - rod_plus[i] * factor
            changes[MINUS_CHANGE, i, d] = rods[MINUS_CHANGE, i, d] * factors[d] - rod_minus[i] * factor
            changes[COMPLIANCE_CHANGE, i, d] = rods[COMPLIANCE_CHANGE, i, d] - work[ALGORITHMIC, i]
            tangents.of_state[ANGLE_CHANGE, i, d] = 0.0
            tangents.of_state[ANCHOR_CHANGE, i, d] = 0.0


@compiled
def follow_tangents(states, new, work, tangents):
    """Changes of angles and anchors at the end of the step that led to `new`."""
    changes, of_state, ratio = tangents.changes, tangents.of_state, tangents.ratio
    n, neighbours = changes.shape[1], changes.shape[2]
    for i in range(n):
        status = states[new, STATUS, i]
        stuck = status == STUCK
        scale = work[ALGORITHMIC, i] if stuck else 1.0
        here = states[new, ANGLE, i]
        before = work[SPRING, i - 1] if i > 0 else 0.0
        after = work[SPRING, i] if i < n - 1 else 0.0
        twist_before = here - states[new, ANGLE, i - 1] if i > 0 else 0.0
        twist_after = here - states[new, ANGLE, i + 1] if i < n - 1 else 0.0
        load = before * twist_before + after * twist_after - work[FORCE, i]
        diagonal = scale * (before + after) + (1.0 if stuck else 0.0)
        pivot = diagonal - (scale * before * ratio[i - 1] if i > 0 else 0.0)
        ratio[i] = scale * after / pivot
        for d in range(neighbours):
            moved = changes[SPRING_CHANGE, i, d] * twist_after
            if i > 0:
                moved += changes[SPRING_CHANGE, i - 1, d] * twist_before
            right = -scale * moved
            if stuck:
                right += of_state[ANCHOR_CHANGE, i, d] - changes[COMPLIANCE_CHANGE, i, d] * load
            elif status < 0.0:
                right += changes[MINUS_CHANGE, i, d]
            elif status != FREE:
                right -= changes[PLUS_CHANGE, i, d]
            if i > 0:
                right += scale * before * of_state[RIGHT, i - 1, d]
            of_state[RIGHT, i, d] = right / pivot
    for i in range(n - 1, -1, -1):
        for d in range(neighbours):
            change = of_state[RIGHT, i, d]
            if i < n - 1:
                change += ratio[i] * of_state[ANGLE_CHANGE, i + 1, d]
            of_state[ANGLE_CHANGE, i, d] = change
    # a slipping node is held where its limit bends the tissue to: its anchor follows
    for i in range(1, n):
        status = states[new, STATUS, i]
        if status == STUCK:
            continue
        for d in range(neighbours):
            anchor = of_state[ANGLE_CHANGE, i, d]
            if status < 0.0:
                anchor += changes[COMPLIANCE_CHANGE, i, d] * work[LIMIT_MINUS, i]
                anchor += work[ALGORITHMIC, i] * changes[MINUS_CHANGE, i, d]
            elif status != FREE:
                anchor -= changes[COMPLIANCE_CHANGE, i, d] * work[LIMIT_PLUS, i]
                anchor -= work[ALGORITHMIC, i] * changes[PLUS_CHANGE, i, d]
            of_state[ANCHOR_CHANGE, i, d] = anchor


@compiled
def store_tangents(states, slot, row, sensors, work, tangents):
    """Write the changes of one sample."""
    changes, of_state = tangents.changes, tangents.of_state
    twist = states[slot, ANGLE, 0] - states[slot, ANGLE, 1]
    for d in range(changes.shape[2]):
        turned = of_state[ANGLE_CHANGE, 0, d] - of_state[ANGLE_CHANGE, 1, d]
        tangents.torque_change_nm[row, d] = work[SPRING, 0] * turned + changes[SPRING_CHANGE, 0, d] * twist
        for s in range(sensors.size):
            tangents.sensor_change_rad[row, s, d] = of_state[ANGLE_CHANGE, sensors[s], d]
