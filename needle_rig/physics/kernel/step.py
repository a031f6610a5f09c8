"""One implicit Euler step of the rod, and what goes before and after one."""

from __future__ import annotations

import math

import numpy as np

from needle_rig.physics.kernel._compile import compiled, copy, vectorised
from needle_rig.physics.kernel.active_set import above_limit, node_torque, solve_for_limits
from needle_rig.physics.kernel.laws import linearise_laws
from needle_rig.physics.kernel.layout import (
    ALGORITHMIC,
    ANCHOR,
    ANCHOR_START,
    ANGLE,
    COMPLIANCE,
    CONSTANT,
    CREEP,
    CREEP_DECAY,
    CREEP_ETA,
    CREEP_K,
    DAMPING,
    FREE,
    KINETIC_MINUS,
    KINETIC_PLUS,
    LIMIT_MINUS,
    LIMIT_PLUS,
    SLIP,
    SLIP_RATE,
    STATUS,
    STATUS_KEPT,
    STEPS,
    STUCK,
    VISCOUS,
)
from needle_rig.physics.kernel.play import start_sides
from needle_rig.physics.kernel.slip_limits import follow_load, follow_memory, linearise_limits

NO_TIME_S = 1e-12
LIMIT_TOLERANCE = 1e-6
"""To which part a slip limit that changes is found in a step."""
MOST_ATTEMPTS = 3
MOST_LIMIT_ITERATIONS = 60
MOST_NEWTON_LIMITS = 8
"""Iterations in which slip limits with memory may fall with the slip; in later ones they are constant."""


@compiled
def set_step_length(rod, has, dt, work):
    """Coefficients of creep and viscosity for steps of length dt."""
    if has.creep:
        for i in range(1, rod.shape[1]):
            k, eta = rod[CREEP_K, i], rod[CREEP_ETA, i]
            creeps = k < np.inf and eta < np.inf
            work[CREEP_DECAY, i] = eta / (eta + dt * k) if creeps else 0.0
            work[ALGORITHMIC, i] = rod[COMPLIANCE, i] + (dt / (eta + dt * k) if creeps else 0.0)
    if has.viscous or has.memory:
        for i in range(rod.shape[1]):
            work[DAMPING, i] = rod[VISCOUS, i] / (dt + work[ALGORITHMIC, i] * rod[VISCOUS, i])


@compiled
def end_of_run(states, slot, status, i):
    """The first node from i on that is neither in state `status` nor free."""
    n = np.uintp(states.shape[2])
    while i < n and (states[slot, STATUS, i] == status or states[slot, STATUS, i] == FREE):
        i += np.uintp(1)
    return i


@compiled
def predict_active_set(states, earlier, now, ratio, guess):
    """The active set if every slip front goes on moving as it did from `earlier` to `now`, times `ratio`.

    That of `now` when `ratio` is not above 0, or fronts have appeared or vanished between the two.
    """
    n = np.uintp(states.shape[2])
    one = np.uintp(1)
    copy(states[now, STATUS], states[guess, STATUS])
    if not ratio > 0.0:
        return
    changes = 0
    for k in range(states.shape[2]):
        changes += 1 if states[earlier, STATUS, k] != states[now, STATUS, k] else 0
    if changes == 0:
        return
    i, j, place = one, one, one
    while True:
        i, j = end_of_run(states, earlier, FREE, i), end_of_run(states, now, FREE, j)
        if j == n:
            return
        status = states[now, STATUS, j]
        if i < n and states[earlier, STATUS, i] == STUCK and status != STUCK:
            # a stuck run between two fronts that have met
            i = end_of_run(states, earlier, STUCK, i)
        if i < n and states[earlier, STATUS, i] == status:
            i = end_of_run(states, earlier, status, i)
        elif status != STUCK or i == n:
            copy(states[now, STATUS], states[guess, STATUS])
            return
        j = end_of_run(states, now, status, j)
        end = n
        if i < n or j < n:
            moved = ratio * (float(j) - float(i))
            end = np.uintp(min(float(n), max(float(place), math.floor(float(j) + moved + 0.5))))
        for k in range(place, end):
            m = np.uintp(k)
            if states[now, STATUS, m] != FREE:
                states[guess, STATUS, m] = status
        place = end


@compiled
def implicit_step(rod, settings, has, laws, states, old, new, guess, dt, base, time, work, counts):
    """One implicit Euler step of length dt from `old` to `new`, whose active set is tried first.

    False: no solution. Rows of `new` that this rod does not change (creep, excess state, age) are left alone.
    """
    n = states.shape[2]
    if has.play:
        start_sides(rod, states, old, work)
    if has.laws:
        copy(states[guess, ANGLE], states[new, ANGLE])
        linearise_laws(rod, laws, states[new, ANGLE], states[old, ANGLE], dt, time, False, work)
    for i in range(n):
        work[ANCHOR_START, i] = states[old, ANCHOR, i]
    if has.creep:
        for i in range(n):
            work[ANCHOR_START, i] += work[CREEP_DECAY, i] * states[old, CREEP, i]
    work[ANCHOR_START, 0] = base
    counts[STEPS] += 1
    attempts = np.intp(MOST_ATTEMPTS)
    if has.memory:
        for i in range(1, n):
            work[SLIP, i] = dt * work[SLIP_RATE, i]
        follow_memory(rod, settings, states, old, new, dt, work)
    if has.loaded:
        follow_load(rod, states, old, work)
    newton = True
    for tried in range(MOST_LIMIT_ITERATIONS if has.memory or has.loaded else 1):
        if has.memory:
            newton = newton and tried < MOST_NEWTON_LIMITS
            linearise_limits(rod, dt, newton, work)
            attempts = np.intp(1 if newton else MOST_ATTEMPTS)
        elif has.loaded:
            for i in range(1, n):
                work[LIMIT_PLUS, i] = work[KINETIC_PLUS, i]
                work[LIMIT_MINUS, i] = work[KINETIC_MINUS, i]
        if solve_for_limits(rod, has, laws, states, old, new, guess, dt, time, work, counts, attempts):
            change = 0.0
            if has.memory:
                change = follow_memory(rod, settings, states, old, new, dt, work)
            if has.loaded:
                change = max(change, follow_load(rod, states, new, work))
            if change < LIMIT_TOLERANCE:
                break
        elif has.memory and newton:
            newton = False
            copy(states[guess, STATUS], states[new, STATUS])
        else:
            return False
    if has.memory:
        for i in range(1, n):
            work[SLIP_RATE, i] = work[SLIP, i] / dt
    move_anchors(rod, has, states, old, new, work)
    states[new, ANCHOR, 0] = base
    return True


@compiled
def move_anchors(rod, has, states, old, new, work):
    """Anchor angle and creep at the end of a step."""
    n = states.shape[2]
    for i in range(1, n):
        states[new, ANCHOR, i] = states[old, ANCHOR, i] + work[SLIP, i]
    if has.creep:
        for i in range(1, n):
            stuck = states[new, STATUS, i] == STUCK
            resist = work[DAMPING, i] * states[new, ANGLE, i] - work[CONSTANT, i]
            after = states[new, ANGLE, min(i + 1, n - 1)]
            torque = node_torque(states, new, work, i, after) if stuck else resist
            grown = (work[ALGORITHMIC, i] - rod[COMPLIANCE, i]) * torque
            states[new, CREEP, i] = work[CREEP_DECAY, i] * states[old, CREEP, i] + grown


@compiled
def inadmissible(rod, states, slot, work, i, angle_after):
    """1 or −1 where a dry node is above its limit, else 0."""
    over = above_limit(node_torque(states, slot, work, i, angle_after), states, slot, work, i)
    return over if (rod[VISCOUS, i] == 0.0) & (states[slot, STATUS, i] != FREE) else 0.0


@vectorised
def count_inadmissible(rod, states, slot, work):
    """How many dry nodes are above their limit; writes nothing, so that it vectorises."""
    last = states.shape[2] - 1
    count = 1 if inadmissible(rod, states, slot, work, last, states[slot, ANGLE, last]) != 0.0 else 0
    for i in range(1, last):
        count += 1 if inadmissible(rod, states, slot, work, i, states[slot, ANGLE, i + 1]) != 0.0 else 0
    return count


@compiled
def project(rod, has, laws, states, slot, before, elapsed, time, work, counts):
    """Project a state that was extrapolated or interpolated to the admissible set; False: not found.

    There a dry node may be above its limit, which no solution of a step is. A step of no length lets such
    nodes slip until they are on it; viscous ones cannot move in it. Slip limits are those in `work`, rates
    for the laws are reckoned since `before`, a time `elapsed` ago. Afterwards `work` needs `set_step_length`.
    """
    n = states.shape[2]
    if has.laws:
        linearise_laws(rod, laws, states[slot, ANGLE], states[before, ANGLE], elapsed, time, False, work)
    if count_inadmissible(rod, states, slot, work) == 0:
        return True
    set_step_length(rod, has, NO_TIME_S, work)
    for i in range(n):
        work[ANCHOR_START, i] = states[slot, ANCHOR, i] + work[CREEP_DECAY, i] * states[slot, CREEP, i]
    for i in range(1, n):
        work[STATUS_KEPT, i] = states[slot, STATUS, i]
        if states[slot, STATUS, i] != FREE:
            after = states[slot, ANGLE, min(i + 1, n - 1)]
            states[slot, STATUS, i] = inadmissible(rod, states, slot, work, i, after)
    attempts = np.intp(MOST_ATTEMPTS)
    solved = solve_for_limits(
        rod, has, laws, states, before, slot, slot, elapsed, time, work, counts, attempts
    )
    if solved:
        move_anchors(rod, has, states, slot, slot, work)
    for i in range(1, n):
        states[slot, STATUS, i] = work[STATUS_KEPT, i]
    return solved
