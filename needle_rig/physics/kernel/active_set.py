"""The complementarity problem of a step: a primal–dual active set method on stuck and slipping nodes.

For fixed slip limits a step is a bounded linear complementarity problem with a P-matrix. Solve the linear
system of an active set {stuck, slipping +, slipping −}, see which nodes contradict their state (a stuck one
above its limit, a slipping one that moves back), change those, and so on (Hintermüller, Ito and Kunisch, SIAM
J. Optim. 13, 2002).
"""

from __future__ import annotations

import math

import numpy as np

from needle_rig.physics.kernel._compile import compiled, copy, vectorised
from needle_rig.physics.kernel.laws import linearise_laws
from needle_rig.physics.kernel.layout import (
    ALGORITHMIC,
    ALGORITHMIC_KEPT,
    ANCHOR_START,
    ANGLE,
    CONSTANT,
    DAMPING,
    DAMPING_KEPT,
    EPS,
    FAILED_NODE,
    FIRST_VIOLATION,
    FORCE,
    FREE,
    LAST_VIOLATION,
    LIMIT_MINUS,
    LIMIT_PLUS,
    SLIP,
    SLOPE,
    SOLVES,
    SPRING,
    STATUS,
    STUCK,
    TORQUE,
    VALUE,
    VIOLATION,
)
from needle_rig.physics.kernel.play import correct_sides, count_wrong_sides
from needle_rig.physics.kernel.tridiagonal import solve_tridiagonal

BACK_SLIP_RAD = 1e-11
"""A slipping node that moves back by less than this does not contradict its state."""
MOST_LINEARISATIONS = 60
"""Iterations of the later attempts in which torque laws are linearised anew."""
MOST_NEWTON = 20
PATIENCE = 2
"""Iterations without fewer violations before an attempt is given up; the last attempt is not."""
PATIENCE_BEFORE_MURTY = 5
SOFTENED_RAD = 1e-8
SMALL_LOAD = 1e-9
"""Part of a node's limits below which a shed load is not followed further."""


@compiled
def node_torque(states, slot, work, i, angle_after):
    """Torque on node i from its neighbours, the next one at `angle_after`, and the laws."""
    here = states[slot, ANGLE, i]
    pulls = work[SPRING, i - 1] * (states[slot, ANGLE, i - 1] - here) + work[SPRING, i] * (angle_after - here)
    return pulls + (work[FORCE, i] + work[SLOPE, i] * here)


@compiled
def above_limit(torque, states, slot, work, i):
    """1 or −1 where a torque is above the limit of node i by more than rounding, else 0."""
    stiffness = work[SPRING, i - 1] + work[SPRING, i]
    rounding = 32.0 * EPS * stiffness * (abs(states[slot, ANGLE, i]) + 1e-3)
    above = 1.0 if torque > work[LIMIT_PLUS, i] * (1.0 + 1e-9) + rounding else 0.0
    return -1.0 if torque < -work[LIMIT_MINUS, i] * (1.0 + 1e-9) - rounding else above


@compiled
def slip_if_slipping(states, slot, work, i):
    """Slip of node i over the step, should it slip."""
    here = states[slot, ANGLE, i]
    return here - work[ANCHOR_START, i] - work[ALGORITHMIC, i] * (work[DAMPING, i] * here - work[CONSTANT, i])


@compiled
def violation(states, slot, work, i, torque):
    """Which way node i, with `torque` on it, wants to leave its state; 0: it does not."""
    status = states[slot, STATUS, i]
    leaves_stuck = above_limit(torque, states, slot, work, i)
    moves_back = status * slip_if_slipping(states, slot, work, i) < -BACK_SLIP_RAD
    leaves_slip = -status if moves_back & (status < FREE) else 0.0
    return leaves_stuck if status == STUCK else leaves_slip


@vectorised
def count_violations(states, slot, work):
    """How many nodes contradict their state in the solution; writes nothing, so that it vectorises."""
    last = states.shape[2] - 1
    count = 0
    for i in range(1, last):
        torque = node_torque(states, slot, work, i, states[slot, ANGLE, i + 1])
        count += 1 if violation(states, slot, work, i, torque) != 0.0 else 0
    torque = node_torque(states, slot, work, last, states[slot, ANGLE, last])
    return count + (1 if violation(states, slot, work, last, torque) != 0.0 else 0)


@vectorised
def mark_violations(states, slot, work, counts):
    """VIOLATION: which way each node wants to leave its state, with the first and last; TORQUE on each."""
    last = states.shape[2] - 1
    for i in range(1, last):
        work[TORQUE, i] = node_torque(states, slot, work, i, states[slot, ANGLE, i + 1])
    work[TORQUE, last] = node_torque(states, slot, work, last, states[slot, ANGLE, last])
    for i in range(1, last + 1):
        work[VIOLATION, i] = violation(states, slot, work, i, work[TORQUE, i])
    first = 1
    while work[VIOLATION, first] == 0.0:
        first += 1
    while work[VIOLATION, last] == 0.0:
        last -= 1
    counts[FIRST_VIOLATION] = first
    counts[LAST_VIOLATION] = last


@vectorised
def store_slip(states, slot, work):
    """SLIP of every node."""
    for i in range(states.shape[2]):
        slip = slip_if_slipping(states, slot, work, i)
        work[SLIP, i] = 0.0 if states[slot, STATUS, i] == STUCK else slip


@compiled
def load_shedding_factor(work, i):
    """How much of the load that node i sheds goes on to the next one.

    1 in rigid tissue, near 0 where the compliance of stuck or the viscosity of slipping tissue spreads it.
    """
    k = max(work[SPRING, i - 1], work[SPRING, i])
    q = max(0.0, work[DAMPING, i] / k)
    slipping = 1.0 + 0.5 * q - math.sqrt(q + 0.25 * q * q)
    ck = work[ALGORITHMIC, i] * k
    sticking = 2.0 * ck / (2.0 * ck + 1.0 + math.sqrt(4.0 * ck + 1.0))
    return slipping * (1.0 - sticking)


@compiled
def loaded_from_base_side(work, angle, angle_before, i, sign):
    """Whether the torque that node i cannot hold came from the base's side since the step began."""
    own = angle[i] - angle_before[i]
    left = work[SPRING, i - 1] * (angle[i - 1] - angle_before[i - 1] - own)
    right = work[SPRING, i] * (angle[i + 1] - angle_before[i + 1] - own) if i < angle.size - 1 else 0.0
    return sign * left > sign * right


@vectorised
def update_active_set(angle, angle_before, status, work, counts):
    """Change the state of the nodes that contradict it.

    In rigid tissue a stuck node feels only its neighbours, so plain flipping would move a slip front by one
    node a solve. The torque that a newly slipping node sheds is therefore carried on to the next stuck one,
    and a run of slipping nodes that went too far is taken back by half; together that is Newton's method on
    the place of the front. `load_shedding_factor` says how much of it applies.
    """
    take_back_fronts(status, work, counts)
    # stuck nodes: what each sheds is carried away from the side that loads it, in both directions
    n = status.size
    torque, wish, carried = work[TORQUE], work[VIOLATION], work[VALUE]
    plus, minus = work[LIMIT_PLUS], work[LIMIT_MINUS]
    first, last = counts[FIRST_VIOLATION], counts[LAST_VIOLATION]
    load = 0.0
    end = first
    for i in range(first, n):
        if i > last and load == 0.0:
            break
        end = i
        carried[i] = load
        state = status[i]
        if state == FREE:
            continue
        if state != STUCK:
            load = 0.0
            continue
        own = torque[i]
        if wish[i] == 0.0 or not loaded_from_base_side(work, angle, angle_before, i, wish[i]):
            own = min(plus[i], max(-minus[i], own))
        load += own
        load -= min(plus[i], max(-minus[i], load))
        load = load * load_shedding_factor(work, i) if abs(load) > SMALL_LOAD * (plus[i] + minus[i]) else 0.0
    load = 0.0
    for i in range(end, 0, -1):
        if i < first and load == 0.0:
            break
        state = status[i]
        if state == FREE:
            continue
        if state != STUCK:
            load = 0.0
            continue
        extra = load + (carried[i] if i >= first else 0.0)
        if wish[i] == 0.0 and extra == 0.0:
            continue
        total = torque[i] + extra
        own = torque[i]
        if wish[i] == 0.0 or loaded_from_base_side(work, angle, angle_before, i, wish[i]):
            own = min(plus[i], max(-minus[i], own))
        load += own
        load -= min(plus[i], max(-minus[i], load))
        load = load * load_shedding_factor(work, i) if abs(load) > SMALL_LOAD * (plus[i] + minus[i]) else 0.0
        if total > plus[i]:
            status[i] = 1.0
        elif total < -minus[i]:
            status[i] = -1.0


@compiled
def take_back_fronts(status, work, counts):
    """Stop slipping nodes that would move back; at the ends of a run only the outer half of them."""
    n = status.size
    wish = work[VIOLATION]
    start = counts[FIRST_VIOLATION]
    while (
        start > 1
        and status[start] != STUCK
        and (status[start - 1] == status[start] or abs(status[start - 1]) == FREE)
    ):
        start -= 1
    while start <= counts[LAST_VIOLATION]:
        sign = status[start]
        if abs(sign) != 1.0:
            start += 1
            continue
        total = 0
        backward = 0
        last = start
        end = start
        while end < n and (status[end] == sign or status[end] == FREE):
            if status[end] == sign:
                total += 1
                last = end
                if wish[end] != 0.0:
                    backward += 1
            end += 1
        if backward > 0:
            low_end = start
            while low_end <= last and (status[low_end] != sign or wish[low_end] != 0.0):
                low_end += 1
            high_end = last
            while high_end >= start and (status[high_end] != sign or wish[high_end] != 0.0):
                high_end -= 1
            keep_low = start + (low_end - start + 1) // 2
            keep_high = last - (last - high_end + 1) // 2
            for i in range(start, last + 1):
                if status[i] == sign and wish[i] != 0.0:
                    inner = keep_low <= i < low_end or high_end < i <= keep_high
                    if backward == total or not inner or load_shedding_factor(work, i) < 0.5:
                        status[i] = STUCK
                    wish[i] = 0.0
            # what the run overturned just past its end
            if end < n and wish[end] == -sign:
                wish[end] = 0.0
                work[TORQUE, end] = max(
                    -work[LIMIT_MINUS, end], min(work[LIMIT_PLUS, end], work[TORQUE, end])
                )
        start = last + 1


@compiled
def solve_for_limits(rod, has, laws, states, old, new, guess, dt, time, work, counts, attempts):
    """Solve the complementarity problem of a step for fixed slip limits; False when it did not converge.

    Where the active set in `new` leads nowhere, the second of at most three attempts starts from that of
    `guess`. In rigid tissue the active set can go in circles where nodes are about to slip: in the third a
    pre-sliding give of `SOFTENED_RAD` at the limit, in this step alone, breaks them; no anchor moves by it.
    """
    n = states.shape[2]
    solved = False
    for attempt in range(attempts):
        if attempt == 1:
            copy(states[guess, STATUS], states[new, STATUS])
            if has.laws:
                copy(states[guess, ANGLE], states[new, ANGLE])
        elif attempt == 2:
            copy(work[ALGORITHMIC], work[ALGORITHMIC_KEPT])
            copy(work[DAMPING], work[DAMPING_KEPT])
            for i in range(1, n):
                largest = max(work[LIMIT_PLUS, i], work[LIMIT_MINUS, i])
                if 0.0 < largest < np.inf:
                    work[ALGORITHMIC, i] = max(work[ALGORITHMIC_KEPT, i], SOFTENED_RAD / largest)
                    softer = work[ALGORITHMIC, i] - work[ALGORITHMIC_KEPT, i]
                    work[DAMPING, i] = work[DAMPING_KEPT, i] / (1.0 + softer * work[DAMPING_KEPT, i])
        solved = iterate_active_set(rod, has, laws, states, old, new, dt, time, work, counts, attempt)
        if solved:
            break
    store_slip(states, new, work)
    if attempt == 2:
        copy(work[ALGORITHMIC_KEPT], work[ALGORITHMIC])
        copy(work[DAMPING_KEPT], work[DAMPING])
    return solved


@compiled
def iterate_active_set(rod, has, laws, states, old, new, dt, time, work, counts, attempt):
    """Update the active set until no node contradicts it; the last attempt, 2, does not give up early.

    Laws are linearised anew before each of the first solves of the later attempts, which strong ones need;
    else only when no node contradicts its state, which takes fewer calls and cannot chase the active set
    round.
    """
    n = states.shape[2]
    linearise_until = MOST_LINEARISATIONS if attempt > 0 else 0
    chord = attempt == 2
    fewest = n + 1
    stalled = 0
    newton = 0
    for iteration in range(MOST_LINEARISATIONS + 20 * n):
        if has.laws and iteration < linearise_until:
            linearise_laws(rod, laws, states[new, ANGLE], states[old, ANGLE], dt, time, chord, work)
        solve_tridiagonal(states, new, has, work)
        counts[SOLVES] += 1
        nodes = count_violations(states, new, work)
        violations = nodes + (count_wrong_sides(rod, states, new, work) if has.play else 0)
        if violations == 0:
            if not has.laws:
                return True
            # Newton on the laws: the linearisation must meet the laws at the new angles
            change = linearise_laws(rod, laws, states[new, ANGLE], states[old, ANGLE], dt, time, chord, work)
            largest = 0.0
            for i in range(n):
                largest = max(largest, abs(work[FORCE, i] + work[SLOPE, i] * states[new, ANGLE, i]))
            if change <= 1e-9 * largest + 1e-18:
                return True
            fewest = n + 1
            stalled = 0
            newton += 1
            if newton > MOST_NEWTON and attempt < 2:
                return False
            continue
        if violations < fewest:
            fewest = violations
            stalled = 0
        else:
            stalled += 1
        if stalled > PATIENCE and attempt < 2:
            return False
        wrong_sides = violations - nodes
        if nodes > 0:
            mark_violations(states, new, work, counts)
        if wrong_sides > 0:
            correct_sides(rod, states, new, work, wrong_sides if stalled <= PATIENCE_BEFORE_MURTY else 1)
            if nodes == 0 or stalled > PATIENCE_BEFORE_MURTY:
                continue
        if stalled <= PATIENCE_BEFORE_MURTY:
            update_active_set(states[new, ANGLE], states[old, ANGLE], states[new, STATUS], work, counts)
        else:
            # Murty: one flip at a time, always the last in order; finite for every P-matrix
            i = counts[LAST_VIOLATION]
            states[new, STATUS, i] = work[VIOLATION, i] if states[new, STATUS, i] == STUCK else STUCK
    counts[FAILED_NODE] = counts[FIRST_VIOLATION]
    return False
