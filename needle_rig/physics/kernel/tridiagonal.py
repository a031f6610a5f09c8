"""The linear system of an active set: tridiagonal, solved by a division-free twisted factorisation.

Rows are eliminated from both ends to the middle, and solved from there outwards: two chains of operations
that need not wait for each other (twisted factorisation: Meurant, SIAM J. Matrix Anal. Appl. 13, 1992). A
pivot is the ratio of two leading principal minors, whose three-term recurrence needs no division.
"""

from __future__ import annotations

import numpy as np

from needle_rig.physics.kernel._compile import compiled, vectorised
from needle_rig.physics.kernel.layout import (
    ALGORITHMIC,
    ANCHOR_START,
    ANGLE,
    CONSTANT,
    DAMPING,
    DIAGONAL,
    FORCE,
    LIMIT_MINUS,
    LIMIT_PLUS,
    LOADED,
    PIVOT,
    RATIO,
    SCALE,
    SLOPE,
    SPRING,
    STATUS,
    STUCK,
    VALUE,
)

RESTART = 8
"""Rows after which the minors start anew from 1, so that they neither overflow nor vanish."""


@vectorised
def assemble(states, new, has, work):
    """Rows of the system for the active set of `new`: SCALE · (Kθ − f) + own θ = CONSTANT or LOADED.

    A stuck row, divided by its stiffness, is compliance · (Kθ − f) + θ = anchor: rigid tissue needs no
    penalty. One row of `work` a loop, as compilers vectorise loops that write little.
    """
    n = states.shape[2]
    for i in range(n):
        compliance = work[ALGORITHMIC, i]
        work[SCALE, i] = compliance if states[new, STATUS, i] == STUCK else 1.0
    for i in range(n):
        status, anchor = states[new, STATUS, i], work[ANCHOR_START, i]
        plus, minus = work[LIMIT_PLUS, i], work[LIMIT_MINUS, i]
        limit = plus if status > 0.0 else -minus
        resist = work[DAMPING, i] * (anchor + work[ALGORITHMIC, i] * limit) - limit
        work[CONSTANT, i] = anchor if status == STUCK else resist
    for i in range(1, n):
        damping = work[DAMPING, i]
        own = 1.0 if states[new, STATUS, i] == STUCK else damping
        work[DIAGONAL, i] = work[SCALE, i] * (work[SPRING, i - 1] + work[SPRING, i]) + own
    work[DIAGONAL, 0] = work[SCALE, 0] * work[SPRING, 0] + 1.0
    if has.laws:
        for i in range(n):
            work[DIAGONAL, i] -= work[SCALE, i] * work[SLOPE, i]
        for i in range(n):
            work[LOADED, i] = work[CONSTANT, i] + work[SCALE, i] * work[FORCE, i]


@compiled
def next_minor(work, rhs, i, spring, spring_inward, minor, minor_before, value, coupling):
    """Row i of an elimination: its leading minor, the one before, the right-hand side and the coupling on."""
    scale = work[SCALE, i]
    outward, inward = scale * spring, scale * spring_inward
    after = work[DIAGONAL, i] * minor - outward * coupling * minor_before
    value = outward * value + work[rhs, i] * minor
    work[RATIO, i] = inward * minor
    work[PIVOT, i] = after
    work[VALUE, i] = value
    return after, minor, value, inward


@vectorised
def leading_minors(work, rhs, n):
    """PIVOT, RATIO and VALUE of the rows on both sides of the middle, each times the minor before its row.

    Where the lower side has a row more than the upper one, that row is the first.
    """
    middle = n // 2
    low, low_before, low_value, low_in, low_spring = 1.0, 0.0, 0.0, 0.0, 0.0
    high, high_before, high_value, high_in, high_spring = 1.0, 0.0, 0.0, 0.0, 0.0
    first = 2 * middle - n + 1
    if first > 0:
        low_spring = work[SPRING, 0]
        low, low_before, low_value, low_in = next_minor(
            work, rhs, np.uintp(0), 0.0, low_spring, 1.0, 0.0, 0.0, 0.0
        )
    for start in range(first, middle, RESTART):
        for k in range(start, min(start + RESTART, middle)):
            i, j = np.uintp(k), np.uintp(n - 1 - k + first)
            spring = work[SPRING, i]
            low, low_before, low_value, low_in = next_minor(
                work, rhs, i, low_spring, spring, low, low_before, low_value, low_in
            )
            low_spring = spring
            spring = work[SPRING, j - np.uintp(1)]
            high, high_before, high_value, high_in = next_minor(
                work, rhs, j, high_spring, spring, high, high_before, high_value, high_in
            )
            high_spring = spring
        inverse = 1.0 / low
        low_before, low, low_value = low_before * inverse, 1.0, low_value * inverse
        inverse = 1.0 / high
        high_before, high, high_value = high_before * inverse, 1.0, high_value * inverse


@vectorised
def solve_tridiagonal(states, new, has, work):
    """Write the angles that solve the system of the active set of `new` into `new`."""
    n = states.shape[2]
    assemble(states, new, has, work)
    rhs = LOADED if has.laws else CONSTANT
    middle = n // 2
    leading_minors(work, rhs, n)
    work[PIVOT, middle] = 1.0
    for i in range(n):
        inverse = 1.0 / work[PIVOT, i]
        work[RATIO, i] *= inverse
        work[VALUE, i] *= inverse
    pull = work[SCALE, middle] * work[SPRING, middle - 1]
    constant = work[rhs, middle] + pull * work[VALUE, middle - 1]
    pivot = work[DIAGONAL, middle] - pull * work[RATIO, middle - 1]
    if middle < n - 1:
        pull = work[SCALE, middle] * work[SPRING, middle]
        constant += pull * work[VALUE, middle + 1]
        pivot -= pull * work[RATIO, middle + 1]
    x = constant / pivot
    x_j = x
    states[new, ANGLE, middle] = x
    for k in range(1, n - middle):
        x = work[VALUE, np.uintp(middle - k)] + work[RATIO, np.uintp(middle - k)] * x
        x_j = work[VALUE, np.uintp(middle + k)] + work[RATIO, np.uintp(middle + k)] * x_j
        states[new, ANGLE, np.uintp(middle - k)] = x
        states[new, ANGLE, np.uintp(middle + k)] = x_j
    if middle > n - 1 - middle:
        states[new, ANGLE, 0] = work[VALUE, 0] + work[RATIO, 0] * x
