"""The compiled solver: implicit steps of the rod and the choice of their lengths.

One step solves K θ + r = f (K tridiagonal, f torque laws) together with the law of each node (see `Rod`) at
the end of the step: a bounded linear complementarity problem with a P-matrix. An active set {stuck, slipping
+, slipping −} is corrected until no node contradicts its own state; rigid tissue needs no penalty because a
stuck row reads compliance · (Kθ − f) + θ = e. Everything is in one file because numba's cache looks only at
the file of the function it stores.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from needle_rig.physics.laws import borrowed, call_law

# rows of `coefficients` (Rod.coefficients)
PLUS, MINUS, COMPLIANCE, CREEP_K, CREEP_ETA, VISCOUS, EXCESS, AGEING, POSITION = range(9)
# rows of a state: angle, grip, creep, bond, age, slip direction
ANGLE, GRIP, CREEP, BOND, AGE, SLIP = range(6)
# scalars
(
    BASE_COMPLIANCE, STRIBECK_RATE, WEAKENING, AGEING_TIME, TOLERANCE, LONGEST, SHORTEST, MOST_SOLVES,
    LONGEST_SLIP,
) = range(9)  # fmt: skip
# counts
STEPS, SOLVES, FAILED_NODE, FAILED_SAMPLE, FIRST_WRONG, LAST_WRONG = range(6)
# what `run` answers, beside 0 and 1
TOO_MANY = 2
# flags
HAS_CREEP, HAS_VISCOUS, HAS_BOND, HAS_LAWS, HAS_DRY, ADAPTIVE = 1, 2, 4, 8, 16, 32
# places in `states`
SLOTS = 8
# rows of the work array
(
    SPRING, C_ALG, DAMP, GRIP0, UP, DOWN, SCALE, DIAGONAL, GIVEN, PIVOT, RATIO, VALUE, MOVE,
    FORCE, SLOPE, RHS, ALPHA, TORQUE, NEXT, C_KEPT, DAMP_KEPT, SLIP_KEPT, FACTOR, FALL, FACTOR_SET, FALL_SET,
    MOVE_SET, RATE,
) = range(28)  # fmt: skip
WORK_ROWS = 28

GAMMA = 1.0 - math.sqrt(0.5)
"""Length of each of the two stages of a step, as a part of it."""
ONWARD = math.sqrt(0.5) / GAMMA
"""The second stage sets out where a rod gets that goes on as in the first one, this many times as long."""

EPS = 2.220446049250313e-16
MOVE_TOLERANCE_RAD = 1e-11
MOST_BLOCK_FLIPS = 60
MOST_NEWTON = 20
MOST_NEWTON_LIMITS = 8
"""Solves of a step in which slip limits with memory may fall with the slip; later ones stand still."""
PER_DECADE = 1.0 / math.log(10.0)
SOFTENED_RAD = 1e-8
NO_TIME_S = 1e-12
LIMIT_TOLERANCE = 1e-6
"""To which part a slip limit with memory is found in a step."""
TORQUE_PER_RAD = 5e-4
"""Error of the base torque (N·m) that counts as much as one radian of error in an angle."""
SMALL_LOAD = 1e-9
"""Part of a node's limits below which a shed load is not followed further."""

_jit = njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")


@_jit
def assemble(states, new, flags, work):  # type: ignore[no-untyped-def]
    """Rows of the linear system for the active set of `new`: SCALE · (Kθ − f) + own θ = GIVEN.

    One row of `work` a loop: compilers make vector code of loops that write little.
    """
    n = states.shape[2]
    for i in range(n):
        compliance = work[C_ALG, i]
        work[SCALE, i] = compliance if states[new, SLIP, i] == 0.0 else 1.0
    for i in range(n):
        state, grip, up, down = states[new, SLIP, i], work[GRIP0, i], work[UP, i], work[DOWN, i]
        limit = up if state > 0.0 else -down
        resist = work[DAMP, i] * (grip + work[C_ALG, i] * limit) - limit
        work[GIVEN, i] = grip if state == 0.0 else resist
    for i in range(1, n):
        damp = work[DAMP, i]
        own = 1.0 if states[new, SLIP, i] == 0.0 else damp
        work[DIAGONAL, i] = work[SCALE, i] * (work[SPRING, i - 1] + work[SPRING, i]) + own
    work[DIAGONAL, 0] = work[SCALE, 0] * work[SPRING, 0] + 1.0
    if flags & HAS_LAWS:
        for i in range(n):
            work[DIAGONAL, i] -= work[SCALE, i] * work[SLOPE, i]
        for i in range(n):
            work[RHS, i] = work[GIVEN, i] + work[SCALE, i] * work[FORCE, i]


@_jit
def minor_of(work, rhs, i, spring, onward, minor, before, value, coupled):  # type: ignore[no-untyped-def]
    """Row i of the elimination: its leading minor, the one before, what goes with it and its coupling on."""
    scale = work[SCALE, i]
    outward, inward = scale * spring, scale * onward
    after = work[DIAGONAL, i] * minor - outward * coupled * before
    value = outward * value + work[rhs, i] * minor
    work[RATIO, i] = inward * minor
    work[PIVOT, i] = after
    work[VALUE, i] = value
    return after, minor, value, inward


@_jit
def eliminate(work, rhs, n):  # type: ignore[no-untyped-def]
    """Leading minors, and what goes with them, of the rows of the linear system on both sides of the middle.

    A pivot is the ratio of two minors, whose recurrence needs no division. They start anew from 1 every
    eighth row, so that they neither overflow nor vanish. Both sides go on at a time, as neither waits for the
    other; where the lower one has a row more, it is the first.
    """
    middle = n // 2
    low, low_before, low_value, low_in, low_spring = 1.0, 0.0, 0.0, 0.0, 0.0
    high, high_before, high_value, high_in, high_spring = 1.0, 0.0, 0.0, 0.0, 0.0
    first = 2 * middle - n + 1
    if first > 0:
        low_spring = work[SPRING, 0]
        low, low_before, low_value, low_in = minor_of(work, rhs, 0, 0.0, low_spring, 1.0, 0.0, 0.0, 0.0)
    for start in range(first, middle, 8):
        for k in range(start, min(start + 8, middle)):
            i, j = np.uintp(k), np.uintp(n - 1 - k + first)
            spring = work[SPRING, i]
            low, low_before, low_value, low_in = minor_of(
                work, rhs, i, low_spring, spring, low, low_before, low_value, low_in
            )
            low_spring = spring
            spring = work[SPRING, j - np.uintp(1)]
            high, high_before, high_value, high_in = minor_of(
                work, rhs, j, high_spring, spring, high, high_before, high_value, high_in
            )
            high_spring = spring
        inverse = 1.0 / low
        low_before, low, low_value = low_before * inverse, 1.0, low_value * inverse
        inverse = 1.0 / high
        high_before, high, high_value = high_before * inverse, 1.0, high_value * inverse


@_jit
def sweep(states, new, flags, work):  # type: ignore[no-untyped-def]
    """Solve the linear system of the active set of `new` into its angles, from both ends to the middle."""
    n = states.shape[2]
    assemble(states, new, flags, work)
    rhs = RHS if flags & HAS_LAWS else GIVEN
    middle = n // 2
    eliminate(work, rhs, n)
    work[PIVOT, middle] = 1.0
    for i in range(n):
        inverse = 1.0 / work[PIVOT, i]
        work[RATIO, i] *= inverse
        work[VALUE, i] *= inverse
    pull = work[SCALE, middle] * work[SPRING, middle - 1]
    given = work[rhs, middle] + pull * work[VALUE, middle - 1]
    pivot = work[DIAGONAL, middle] - pull * work[RATIO, middle - 1]
    if middle < n - 1:
        pull = work[SCALE, middle] * work[SPRING, middle]
        given += pull * work[VALUE, middle + 1]
        pivot -= pull * work[RATIO, middle + 1]
    x = given / pivot
    x_j = x
    states[new, ANGLE, middle] = x
    for k in range(1, n - middle):
        x = work[VALUE, np.uintp(middle - k)] + work[RATIO, np.uintp(middle - k)] * x
        x_j = work[VALUE, np.uintp(middle + k)] + work[RATIO, np.uintp(middle + k)] * x_j
        states[new, ANGLE, np.uintp(middle - k)] = x
        states[new, ANGLE, np.uintp(middle + k)] = x_j
    if middle > n - 1 - middle:
        states[new, ANGLE, 0] = work[VALUE, 0] + work[RATIO, 0] * x


@_jit
def held(states, new, work, i, after):  # type: ignore[no-untyped-def]
    """Torque on node i from its neighbours, the next one at angle `after`, and the laws."""
    here = states[new, ANGLE, i]
    pulls = work[SPRING, i - 1] * (states[new, ANGLE, i - 1] - here) + work[SPRING, i] * (after - here)
    return pulls + (work[FORCE, i] + work[SLOPE, i] * here)


@_jit
def beyond(hold, states, new, work, i):  # type: ignore[no-untyped-def]
    """1 or −1 where a torque is above the limit of node i by more than rounding, else 0."""
    stiffness = work[SPRING, i - 1] + work[SPRING, i]
    rounding = 32.0 * EPS * stiffness * (abs(states[new, ANGLE, i]) + 1e-3)
    above = 1.0 if hold > work[UP, i] * (1.0 + 1e-9) + rounding else 0.0
    return -1.0 if hold < -work[DOWN, i] * (1.0 + 1e-9) - rounding else above


@_jit
def slipped(states, new, work, i):  # type: ignore[no-untyped-def]
    """How far node i moved if it slips."""
    here = states[new, ANGLE, i]
    return here - work[GRIP0, i] - work[C_ALG, i] * (work[DAMP, i] * here - work[GIVEN, i])


@_jit
def wrong(states, new, work, i, hold):  # type: ignore[no-untyped-def]
    """Which way node i, with the torque `hold` on it, wants to leave its state; 0: it does not."""
    state = states[new, SLIP, i]
    sticking = beyond(hold, states, new, work, i)
    back = state * slipped(states, new, work, i) < -MOVE_TOLERANCE_RAD
    slipping = -state if back & (state < 2.0) else 0.0
    return sticking if state == 0.0 else slipping


@_jit
def contradicted(states, new, work):  # type: ignore[no-untyped-def]
    """How many nodes contradict their state in the solution; writes nothing, so that it is vector code."""
    last = states.shape[2] - 1
    bad = 0
    for i in range(1, last):
        hold = held(states, new, work, i, states[new, ANGLE, i + 1])
        bad += 1 if wrong(states, new, work, i, hold) != 0.0 else 0
    hold = held(states, new, work, last, states[new, ANGLE, last])
    return bad + (1 if wrong(states, new, work, last, hold) != 0.0 else 0)


@_jit
def mark(states, new, work, counts):  # type: ignore[no-untyped-def]
    """NEXT: which way the nodes that contradict their state want to go; TORQUE: what stuck nodes hold."""
    last = states.shape[2] - 1
    for i in range(1, last):
        work[TORQUE, i] = held(states, new, work, i, states[new, ANGLE, i + 1])
    work[TORQUE, last] = held(states, new, work, last, states[new, ANGLE, last])
    for i in range(1, last + 1):
        work[NEXT, i] = wrong(states, new, work, i, work[TORQUE, i])
    first = 1
    while work[NEXT, first] == 0.0:
        first += 1
    while work[NEXT, last] == 0.0:
        last -= 1
    counts[FIRST_WRONG] = first
    counts[LAST_WRONG] = last


@_jit
def moves(states, new, work):  # type: ignore[no-untyped-def]
    """MOVE: the slip of every node."""
    for i in range(states.shape[2]):
        moved = slipped(states, new, work, i)
        work[MOVE, i] = 0.0 if states[new, SLIP, i] == 0.0 else moved


@_jit
def reach(work, i):  # type: ignore[no-untyped-def]
    """How much of the load that node i sheds goes on to the next one.

    1 in rigid tissue, near 0 where the compliance of stuck or the viscosity of slipping tissue spreads it.
    """
    k = max(work[SPRING, i - 1], work[SPRING, i])
    q = max(0.0, work[DAMP, i] / k)
    slipping = 1.0 + 0.5 * q - math.sqrt(q + 0.25 * q * q)
    ck = work[C_ALG, i] * k
    sticking = 2.0 * ck / (2.0 * ck + 1.0 + math.sqrt(4.0 * ck + 1.0))
    return slipping * (1.0 - sticking)


@_jit
def correct(angle, before, slip, work, counts):  # type: ignore[no-untyped-def]
    """Flip the contradicting nodes.

    In rigid tissue a stuck node feels only its neighbours, so plain flipping would move a slip front by one
    node a solve. The torque that a newly slipping node sheds is therefore carried on to the next stuck one,
    and a run of slipping nodes that went too far is taken back by half; together that is Newton's method on
    the place of the front. `reach` says how much of it applies.
    """
    retreat(slip, work, counts)
    # stuck nodes: what each sheds is carried away from the side that pulls it, in both directions
    n = slip.size
    torque, nxt, carried = work[TORQUE], work[NEXT], work[VALUE]
    up, down = work[UP], work[DOWN]
    first, last = counts[FIRST_WRONG], counts[LAST_WRONG]
    load = 0.0
    end = first
    for i in range(first, n):
        if i > last and load == 0.0:
            break
        end = i
        carried[i] = load
        state = slip[i]
        if state == 2.0:
            continue
        if state != 0.0:
            load = 0.0
            continue
        own = torque[i]
        if nxt[i] == 0.0 or not pulled_from_left(work, angle, before, i, nxt[i]):
            own = min(up[i], max(-down[i], own))
        load += own
        load -= min(up[i], max(-down[i], load))
        load = load * reach(work, i) if abs(load) > SMALL_LOAD * (up[i] + down[i]) else 0.0
    load = 0.0
    for i in range(end, 0, -1):
        if i < first and load == 0.0:
            break
        state = slip[i]
        if state == 2.0:
            continue
        if state != 0.0:
            load = 0.0
            continue
        extra = load + (carried[i] if i >= first else 0.0)
        if nxt[i] == 0.0 and extra == 0.0:
            continue
        total = torque[i] + extra
        own = torque[i]
        if nxt[i] == 0.0 or pulled_from_left(work, angle, before, i, nxt[i]):
            own = min(up[i], max(-down[i], own))
        load += own
        load -= min(up[i], max(-down[i], load))
        load = load * reach(work, i) if abs(load) > SMALL_LOAD * (up[i] + down[i]) else 0.0
        if total > up[i]:
            slip[i] = 1.0
        elif total < -down[i]:
            slip[i] = -1.0


@_jit
def retreat(slip, work, counts):  # type: ignore[no-untyped-def]
    """Stop slipping nodes that would move against their slip; at the end of a run only the outer half."""
    n = slip.size
    nxt = work[NEXT]
    start = counts[FIRST_WRONG]
    while (
        start > 1 and slip[start] != 0.0 and (slip[start - 1] == slip[start] or abs(slip[start - 1]) == 2.0)
    ):
        start -= 1
    while start <= counts[LAST_WRONG]:
        sign = slip[start]
        if abs(sign) != 1.0:
            start += 1
            continue
        total = 0
        wrong = 0
        last = start
        end = start
        while end < n and (slip[end] == sign or slip[end] == 2.0):
            if slip[end] == sign:
                total += 1
                last = end
                if nxt[end] != 0.0:
                    wrong += 1
            end += 1
        if wrong > 0:
            low_end = start
            while low_end <= last and (slip[low_end] != sign or nxt[low_end] != 0.0):
                low_end += 1
            high_end = last
            while high_end >= start and (slip[high_end] != sign or nxt[high_end] != 0.0):
                high_end -= 1
            keep_low = start + (low_end - start + 1) // 2
            keep_high = last - (last - high_end + 1) // 2
            for i in range(start, last + 1):
                if slip[i] == sign and nxt[i] != 0.0:
                    inner = keep_low <= i < low_end or high_end < i <= keep_high
                    if wrong == total or not inner or reach(work, i) < 0.5:
                        slip[i] = 0.0
                    nxt[i] = 0.0
            # what the run overturned just past its end
            if end < n and nxt[end] == -sign:
                nxt[end] = 0.0
                work[TORQUE, end] = max(-work[DOWN, end], min(work[UP, end], work[TORQUE, end]))
        start = last + 1


@_jit
def pulled_from_left(work, angle, before, i, sign):  # type: ignore[no-untyped-def]
    """Whether the torque that node i cannot hold came from the base's side since the step began."""
    own = angle[i] - before[i]
    left = work[SPRING, i - 1] * (angle[i - 1] - before[i - 1] - own)
    right = work[SPRING, i] * (angle[i + 1] - before[i + 1] - own) if i < angle.size - 1 else 0.0
    return sign * left > sign * right


@_jit
def evaluate_laws(rod, laws, angle, before, dt, time, work):  # type: ignore[no-untyped-def]
    """Linearise the torque laws about `angle`: work[FORCE] + work[SLOPE] · θ. Largest change at `angle`."""
    addresses, parameters, weights = laws
    change = 0.0
    for i in range(angle.size):
        value = 0.0
        gradient = 0.0
        rate = (angle[i] - before[i]) / dt
        for k in range(addresses.size):
            weight = weights[k, i]
            if weight == 0.0:
                continue
            a, p, x = addresses[k], parameters[k], rod[POSITION, i]
            here = call_law(a, p, angle[i], rate, time, x)
            by_angle = (call_law(a, p, angle[i] + 1e-7, rate, time, x) - here) / 1e-7
            step = 1e-7 * (1.0 + abs(rate))
            by_rate = (call_law(a, p, angle[i], rate + step, time, x) - here) / step
            value += weight * here
            gradient += weight * (by_angle + by_rate / dt)
        change = max(change, abs(work[FORCE, i] + work[SLOPE, i] * angle[i] - value))
        work[FORCE, i] = value - gradient * angle[i]
        work[SLOPE, i] = gradient
    return change


@_jit
def set_length(rod, flags, dt, work):  # type: ignore[no-untyped-def]
    """Coefficients of creep and viscosity for steps of length dt."""
    if flags & HAS_CREEP:
        for i in range(1, rod.shape[1]):
            k, eta = rod[CREEP_K, i], rod[CREEP_ETA, i]
            creeps = k < np.inf and eta < np.inf
            work[ALPHA, i] = eta / (eta + dt * k) if creeps else 0.0
            work[C_ALG, i] = rod[COMPLIANCE, i] + (dt / (eta + dt * k) if creeps else 0.0)
    if flags & HAS_VISCOUS or flags & HAS_BOND:
        for i in range(rod.shape[1]):
            work[DAMP, i] = rod[VISCOUS, i] / (dt + work[C_ALG, i] * rod[VISCOUS, i])


@_jit
def past(states, slot, state, i):  # type: ignore[no-untyped-def]
    """The first node from i on that is neither in `state` nor free."""
    while i < np.uintp(states.shape[2]) and (states[slot, SLIP, i] == state or states[slot, SLIP, i] == 2.0):
        i += np.uintp(1)
    return i


@_jit
def predict_slip(states, earlier, now, ratio, guess):  # type: ignore[no-untyped-def]
    """The active set if every slip front goes on moving as it did from `earlier` to `now`, times `ratio`.

    Just that of `now` when fronts have appeared or vanished between the two. Nodes of state 2 have no say.
    """
    n = np.uintp(states.shape[2])
    one = np.uintp(1)
    for k in range(states.shape[2]):
        states[guess, SLIP, k] = states[now, SLIP, k]
    changes = 0
    for k in range(states.shape[2]):
        changes += 1 if states[earlier, SLIP, k] != states[now, SLIP, k] else 0
    if changes == 0:
        return
    i, j, place = one, one, one
    while True:
        i, j = past(states, earlier, 2.0, i), past(states, now, 2.0, j)
        if j == n:
            return
        state = states[now, SLIP, j]
        if i < n and states[earlier, SLIP, i] == 0.0 and state != 0.0:
            # a stuck run between two fronts that have met
            i = past(states, earlier, 0.0, i)
        if i < n and states[earlier, SLIP, i] == state:
            i = past(states, earlier, state, i)
        elif state != 0.0 or i == n:
            for k in range(states.shape[2]):
                states[guess, SLIP, k] = states[now, SLIP, k]
            return
        j = past(states, now, state, j)
        end = n
        if i < n or j < n:
            moved = ratio * (float(j) - float(i))
            end = np.uintp(min(float(n), max(float(place), math.floor(float(j) + moved + 0.5))))
        for k in range(place, end):
            m = np.uintp(k)
            if states[now, SLIP, m] != 2.0:
                states[guess, SLIP, m] = state
        place = end


@_jit
def step(  # type: ignore[no-untyped-def]
    rod, scalars, flags, laws, states, old, new, guess, dt, base, time, work, counts
):
    """One implicit step of length dt from `old` to `new`, whose slip holds the active set to try first.

    False: no solution. Rows of `new` that this rod does not change (bond, age, creep) are left alone.
    """
    n = states.shape[2]
    if flags & HAS_LAWS:
        states[new, ANGLE] = states[guess, ANGLE]
        evaluate_laws(rod, laws, states[new, ANGLE], states[old, ANGLE], dt, time, work)
    for i in range(n):
        work[GRIP0, i] = states[old, GRIP, i]
    if flags & HAS_CREEP:
        for i in range(n):
            work[GRIP0, i] += work[ALPHA, i] * states[old, CREEP, i]
    work[GRIP0, 0] = base
    counts[STEPS] += 1
    if flags & HAS_BOND:
        for i in range(1, n):
            work[MOVE, i] = dt * work[RATE, i]
        follow_bond(rod, scalars, states, old, new, dt, work)
        newton = True
        for tried in range(60):
            newton = newton and tried < MOST_NEWTON_LIMITS
            expect_limits(rod, dt, newton, work)
            attempts = 1 if newton else 3
            if balance(rod, flags, laws, states, old, new, guess, dt, time, work, counts, attempts):
                if follow_bond(rod, scalars, states, old, new, dt, work) < LIMIT_TOLERANCE:
                    break
            elif newton:
                newton = False
                states[new, SLIP] = states[guess, SLIP]
            else:
                return False
        for i in range(1, n):
            work[RATE, i] = work[MOVE, i] / dt
    elif not balance(rod, flags, laws, states, old, new, guess, dt, time, work, counts, 3):
        return False
    finish(rod, flags, states, old, new, work)
    states[new, GRIP, 0] = base
    return True


@_jit
def finish(rod, flags, states, old, new, work):  # type: ignore[no-untyped-def]
    """Grip and creep at the end of a step."""
    n = states.shape[2]
    for i in range(1, n):
        states[new, GRIP, i] = states[old, GRIP, i] + work[MOVE, i]
    if flags & HAS_CREEP:
        for i in range(1, n):
            stuck = states[new, SLIP, i] == 0.0
            resist = work[DAMP, i] * states[new, ANGLE, i] - work[GIVEN, i]
            torque = held(states, new, work, i, states[new, ANGLE, min(i + 1, n - 1)]) if stuck else resist
            grown = (work[C_ALG, i] - rod[COMPLIANCE, i]) * torque
            states[new, CREEP, i] = work[ALPHA, i] * states[old, CREEP, i] + grown


@_jit
def overloaded(rod, states, slot, work, i, after):  # type: ignore[no-untyped-def]
    """1 or −1 where a dry node is above its limit, else 0."""
    over = beyond(held(states, slot, work, i, after), states, slot, work, i)
    return over if (rod[VISCOUS, i] == 0.0) & (states[slot, SLIP, i] != 2.0) else 0.0


@_jit
def admit(rod, flags, laws, states, slot, before, elapsed, time, work, counts):  # type: ignore[no-untyped-def]
    """Return a state that was extrapolated or interpolated to the admissible set; False: not found.

    There a dry node may be above its limit, which no solution of a step is. A step of no length lets such
    nodes slip until they are on it; viscous ones cannot move in it. Slip limits are those in `work`, rates
    for the laws are reckoned since `before`, a time `elapsed` ago. Afterwards `work` needs `set_length`.
    """
    n = states.shape[2]
    if flags & HAS_LAWS:
        evaluate_laws(rod, laws, states[slot, ANGLE], states[before, ANGLE], elapsed, time, work)
    last = n - 1
    bad = 1 if overloaded(rod, states, slot, work, last, states[slot, ANGLE, last]) != 0.0 else 0
    for i in range(1, last):
        bad += 1 if overloaded(rod, states, slot, work, i, states[slot, ANGLE, i + 1]) != 0.0 else 0
    if bad == 0:
        return True
    set_length(rod, flags, NO_TIME_S, work)
    for i in range(n):
        work[GRIP0, i] = states[slot, GRIP, i] + work[ALPHA, i] * states[slot, CREEP, i]
    for i in range(1, n):
        work[SLIP_KEPT, i] = states[slot, SLIP, i]
        if states[slot, SLIP, i] != 2.0:
            after = states[slot, ANGLE, min(i + 1, last)]
            states[slot, SLIP, i] = overloaded(rod, states, slot, work, i, after)
    solved = balance(rod, flags, laws, states, before, slot, slot, elapsed, time, work, counts, 3)
    if solved:
        finish(rod, flags, states, slot, slot, work)
    for i in range(1, n):
        states[slot, SLIP, i] = work[SLIP_KEPT, i]
    return solved


@_jit
def set_limits(rod, scalars, states, one, other, slack, work):  # type: ignore[no-untyped-def]
    """Slip limits, times `slack`, for the bond and age of the states `one` or `other`, the higher ones."""
    for i in range(states.shape[2]):
        factor = 1.0 + rod[EXCESS, i] * max(states[one, BOND, i], states[other, BOND, i])
        if rod[AGEING, i] > 0.0:
            age = max(states[one, AGE, i], states[other, AGE, i])
            factor += rod[AGEING, i] * PER_DECADE * math.log(1.0 + age / scalars[AGEING_TIME])
        factor *= slack
        work[UP, i] = rod[PLUS, i] * factor
        work[DOWN, i] = rod[MINUS, i] * factor


@_jit
def follow_bond(rod, scalars, states, old, new, dt, work):  # type: ignore[no-untyped-def]
    """Bond and age at the end of a step with the slip MOVE, and FACTOR of the limits, which FALL with it.

    Returns the largest error of a factor that was expected.
    """
    rate, weakening, rest = scalars[STRIBECK_RATE], scalars[WEAKENING], scalars[AGEING_TIME]
    largest = 0.0
    for i in range(1, states.shape[2]):
        moved = abs(work[MOVE, i])
        factor, fall = 1.0, 0.0
        if rod[EXCESS, i] > 0.0:
            ratio = moved / (dt * rate)
            gain = (moved + dt * rate) / weakening
            target = math.exp(-ratio * ratio)
            bond = (states[old, BOND, i] + gain * target) / (1.0 + gain)
            slope = (target - bond) / weakening - 2.0 * gain * ratio * target / (dt * rate)
            factor += rod[EXCESS, i] * bond
            fall += rod[EXCESS, i] * slope / (1.0 + gain)
            states[new, BOND, i] = bond
        if rod[AGEING, i] > 0.0:
            age = (states[old, AGE, i] + dt) * weakening / (weakening + moved)
            factor += rod[AGEING, i] * PER_DECADE * math.log(1.0 + age / rest)
            fall -= rod[AGEING, i] * PER_DECADE * age / ((weakening + moved) * (rest + age))
            states[new, AGE, i] = age
        work[FACTOR, i], work[FALL, i] = factor, fall
        error = abs(factor - work[FACTOR_SET, i] - work[FALL_SET, i] * moved)
        # a fall expected in one direction says nothing of the other
        largest = max(largest, error if work[MOVE, i] * work[MOVE_SET, i] >= 0.0 else 1.0)
    return largest


@_jit
def expect_limits(rod, dt, newton, work):  # type: ignore[no-untyped-def]
    """Set the slip limits to FACTOR, by Newton's method falling with the slip: a viscosity below zero."""
    for i in range(1, rod.shape[1]):
        move = work[MOVE, i]
        damp, fall = rod[VISCOUS, i] / dt, 0.0
        steep = work[FALL, i] * (rod[PLUS, i] if move > 0.0 else rod[MINUS, i])
        # tissue whose limit falls faster than it unloads snaps: no slope to go by
        if newton and move != 0.0 and 1.0 + work[C_ALG, i] * (damp + steep) > 0.5:
            damp, fall = damp + steep, work[FALL, i]
        factor = work[FACTOR, i] - fall * abs(move)
        work[FACTOR_SET, i], work[FALL_SET, i], work[MOVE_SET, i] = factor, fall, move
        work[UP, i] = rod[PLUS, i] * factor
        work[DOWN, i] = rod[MINUS, i] * factor
        work[DAMP, i] = damp / (1.0 + work[C_ALG, i] * damp)


@_jit
def balance(  # type: ignore[no-untyped-def]
    rod, flags, laws, states, old, new, guess, dt, time, work, counts, attempts
):
    """Solve the step's complementarity problem for fixed slip limits; False when it did not converge.

    Where the active set in `new` leads nowhere, the second of at most three attempts starts from that of
    `guess`. In rigid tissue the correction of the active set can go in circles where nodes are about to slip:
    in the third a pre-sliding give of `SOFTENED_RAD` at the limit, in this step alone, breaks them; no grip
    moves by it.
    """
    n = states.shape[2]
    solved = False
    for attempt in range(attempts):
        if attempt == 1:
            states[new, SLIP] = states[guess, SLIP]
            if flags & HAS_LAWS:
                states[new, ANGLE] = states[guess, ANGLE]
        elif attempt == 2:
            work[C_KEPT] = work[C_ALG]
            work[DAMP_KEPT] = work[DAMP]
            for i in range(1, n):
                largest = max(work[UP, i], work[DOWN, i])
                if 0.0 < largest < np.inf:
                    work[C_ALG, i] = max(work[C_KEPT, i], SOFTENED_RAD / largest)
                    softer = work[C_ALG, i] - work[C_KEPT, i]
                    work[DAMP, i] = work[DAMP_KEPT, i] / (1.0 + softer * work[DAMP_KEPT, i])
        solved = settle(rod, flags, laws, states, old, new, dt, time, work, counts, attempt)
        if solved:
            break
    moves(states, new, work)
    if attempt == 2:
        work[C_ALG] = work[C_KEPT]
        work[DAMP] = work[DAMP_KEPT]
    return solved


@_jit
def settle(rod, flags, laws, states, old, new, dt, time, work, counts, attempt):  # type: ignore[no-untyped-def]
    """Correct the active set until no node contradicts it; the last attempt, 2, does not give up early.

    Laws are linearised anew before each of the first solves of the later attempts, which strong ones need;
    else only when the active set has settled, which takes fewer calls and cannot chase it round.
    """
    n = states.shape[2]
    eager = MOST_BLOCK_FLIPS if attempt > 0 else 0
    best = n + 1
    stalled = 0
    newton = 0
    for iteration in range(MOST_BLOCK_FLIPS + 20 * n):
        if flags & HAS_LAWS and iteration < eager:
            evaluate_laws(rod, laws, states[new, ANGLE], states[old, ANGLE], dt, time, work)
        sweep(states, new, flags, work)
        counts[SOLVES] += 1
        bad = contradicted(states, new, work)
        if bad == 0:
            if flags & HAS_LAWS == 0:
                return True
            # Newton on the laws: the linearisation must meet the laws at the new angles
            change = evaluate_laws(rod, laws, states[new, ANGLE], states[old, ANGLE], dt, time, work)
            largest = 0.0
            for i in range(n):
                largest = max(largest, abs(work[FORCE, i] + work[SLOPE, i] * states[new, ANGLE, i]))
            if change <= 1e-9 * largest + 1e-18:
                return True
            best = n + 1
            stalled = 0
            newton += 1
            if newton > MOST_NEWTON and attempt < 2:
                return False
            continue
        if bad < best:
            best = bad
            stalled = 0
        else:
            stalled += 1
        if stalled > 2 and attempt < 2:
            return False
        mark(states, new, work, counts)
        if stalled < 6:
            correct(states[new, ANGLE], states[old, ANGLE], states[new, SLIP], work, counts)
        else:
            # Murty: one flip at a time, always the last in order; finite for every P-matrix
            i = counts[LAST_WRONG]
            states[new, SLIP, i] = work[NEXT, i] if states[new, SLIP, i] == 0.0 else 0.0
    counts[FAILED_NODE] = counts[FIRST_WRONG]
    return False


@_jit
def store(rod, flags, laws, stiffness, states, slot, time, row, sensors, outputs):  # type: ignore[no-untyped-def]
    """Write one output sample: torque that the base exerts on the needle, and angles."""
    out_torque, out_sensor, out_tip, out_shaft = outputs
    torque = stiffness[0] * (states[slot, ANGLE, 0] - states[slot, ANGLE, 1])
    if flags & HAS_LAWS:
        addresses, parameters, weights = laws
        for k in range(addresses.size):
            if weights[k, 0] != 0.0:
                torque -= weights[k, 0] * call_law(
                    addresses[k], parameters[k], states[slot, ANGLE, 0], 0.0, time, rod[POSITION, 0]
                )
    out_torque[row] = torque
    for s in range(sensors.size):
        out_sensor[row, s] = states[slot, ANGLE, sensors[s]]
    out_tip[row] = states[slot, ANGLE, states.shape[2] - 1]
    if out_shaft.shape[0] > 0:
        out_shaft[row] = states[slot, ANGLE]


@_jit
def angle_of_base(times, base, sample, time):  # type: ignore[no-untyped-def]
    """Base angle at `time`, which does not lie before sample `sample`."""
    while times[sample + 1] < time:
        sample += 1
    fraction = (time - times[sample]) / (times[sample + 1] - times[sample])
    return base[sample] + fraction * (base[sample + 1] - base[sample])


@_jit
def end_of_line(times, base, row):  # type: ignore[no-untyped-def]
    """The sample at which the straight line of the base path that starts at `row` ends."""
    rate = (base[row + 1] - base[row]) / (times[row + 1] - times[row])
    end = row + 1
    while end < times.size - 1:
        dt = times[end + 1] - times[end]
        if abs((base[end + 1] - base[end]) / dt - rate) * dt > 1e-9:
            break
        end += 1
    return end


@_jit
def furthest_sample(times, base, time, length, row, next_kink, has_earlier, flags, tolerance):  # type: ignore[no-untyped-def]
    """The last sample that a step of `length` may reach.

    While the base moves a sensor that dry friction holds can start or stop between two samples, so that no
    sample may lie inside a step then, save in its middle, where a half step ends.
    """
    dry = flags & (HAS_DRY | HAS_BOND) != 0
    target = row + 1
    while target < next_kink and times[target + 1] - time <= length * (1.0 + 1e-9):
        still = abs(base[target + 1] - base[row]) <= 10.0 * tolerance
        if not has_earlier or (dry and not still):
            middle = abs(times[row + 2] + time - 2.0 * times[row + 1]) <= 1e-6 * length
            if flags & HAS_BOND and target == row + 1 and middle:
                target += 1
            break
        target += 1
    return target


@_jit
def go_onward(rod, states, now, stage, start, flags):  # type: ignore[no-untyped-def]
    """The state from which the second stage of a step sets out.

    What changes at a rate goes on as in the first stage; dry friction, which knows no rate, is followed.
    """
    for r in range(3 if flags & HAS_CREEP else 2):
        for i in range(states.shape[2]):
            states[start, r, i] = states[now, r, i] + ONWARD * (states[stage, r, i] - states[now, r, i])
    states[start, SLIP] = states[stage, SLIP]
    if flags & HAS_DRY:
        for i in range(states.shape[2]):
            states[start, GRIP, i] = states[start if rod[VISCOUS, i] > 0.0 else stage, GRIP, i]


@_jit
def conclude(states, now, stage, half, end, full, rate, dt, rows):  # type: ignore[no-untyped-def]
    """After both stages: the rate at the end, the state in the middle, and `full`, to compare with the end.

    The middle lies on the parabola with the rate at the end; `full` lacks half of what the rate changed by.
    """
    for i in range(states.shape[2]):
        first = states[stage, ANGLE, i] - states[now, ANGLE, i]
        second = states[end, ANGLE, i] - states[now, ANGLE, i] - ONWARD * first
        states[rate, ANGLE, i] = second / (GAMMA * dt)
        states[full, ANGLE, i] = states[end, ANGLE, i] - 0.5 * (second - first)
        states[half, SLIP, i] = states[stage, SLIP, i]
    for r in range(rows):
        for i in range(states.shape[2]):
            first = states[stage, r, i] - states[now, r, i]
            gone = states[end, r, i] - states[now, r, i]
            bent = 0.25 / GAMMA * (gone - ONWARD * first)
            states[half, r, i] = states[now, r, i] + (0.75 * gone - bent)


@_jit
def extrapolate(rod, states, half, end, full, flags, ageing_time):  # type: ignore[no-untyped-def]
    """Take the error of first order out of the states after one and two half steps."""
    n = states.shape[2]
    for r in range(3 if flags & HAS_CREEP else 2):
        for i in range(n):
            states[half, r, i] += 0.5 * (states[end, r, i] - states[full, r, i])
        for i in range(n):
            states[end, r, i] += states[end, r, i] - states[full, r, i]
    if flags & HAS_BOND:
        for i in range(n):
            states[end, BOND, i] = min(1.0, max(0.0, 2.0 * states[end, BOND, i] - states[full, BOND, i]))
            # other ages are not set by steps: rounding would double each time
            if rod[AGEING, i] > 0.0:
                # of the logarithm, to which the limit is proportional
                grown = (ageing_time + states[end, AGE, i]) ** 2 / (ageing_time + states[full, AGE, i])
                states[end, AGE, i] = max(0.0, grown - ageing_time)


@njit(cache=True, nogil=True, fastmath=True)
def largest_difference(states, a, b):  # type: ignore[no-untyped-def]
    """Largest difference of angles."""
    largest = 0.0
    for i in range(states.shape[2]):
        largest = max(largest, abs(states[a, ANGLE, i] - states[b, ANGLE, i]))
    return largest


@njit(cache=True, nogil=True, fastmath=True)
def missed_by_quadratic(states, before, now, half, end, gap, dt):  # type: ignore[no-untyped-def]
    """Largest error of a quadratic through a step, from the next divided difference.

    `before` is the state a time `gap` before `now`.
    """
    w_before = 1.0 / (gap * (gap + 0.5 * dt) * (gap + dt))
    w_now = -2.0 / (gap * dt * dt)
    w_half = 4.0 / (dt * dt * (gap + 0.5 * dt))
    w_end = -2.0 / (dt * dt * (gap + dt))
    worst = 0.0
    for i in range(states.shape[2]):
        third = w_before * states[before, ANGLE, i] + w_now * states[now, ANGLE, i]
        third += w_half * states[half, ANGLE, i] + w_end * states[end, ANGLE, i]
        worst = max(worst, abs(third))
    return worst * 0.0481 * dt**3


@_jit
def missed_by_parabola(states, now, stage, last_rate, rate, dt, i):  # type: ignore[no-untyped-def]
    """Error at node i between the ends of a step in two stages.

    1.5 times the distance of the rate in the first stage from the line between the rates at the ends bounds
    the error where a rate jumps, wherever in the step that is.
    """
    line = (1.0 - GAMMA) * states[last_rate, ANGLE, i] + GAMMA * states[rate, ANGLE, i]
    return 1.5 * (dt * line - (states[stage, ANGLE, i] - states[now, ANGLE, i]) / GAMMA)


@_jit
def blend(states, now, half, end, x, rows, out):  # type: ignore[no-untyped-def]
    """The first `rows` rows of a state at the fraction x of a step, on a quadratic through the step."""
    w0, w1, w2 = (2.0 * x - 1.0) * (x - 1.0), 4.0 * x * (1.0 - x), x * (2.0 * x - 1.0)
    for r in range(rows):
        for i in range(states.shape[2]):
            ends = w0 * states[now, r, i] + w2 * states[end, r, i]
            states[out, r, i] = ends + w1 * states[half, r, i]


@njit(
    "int64(float64[::1], float64[:, ::1], float64[::1], int64, int64[::1], int64[::1], float64[:, ::1],"
    " float64[::1], float64[::1], int64[::1], float64[:, :, ::1], float64[:, ::1], float64[::1],"
    " float64[:, ::1], float64[::1], float64[:, ::1], int64[::1])",
    cache=True,
    nogil=True,
    fastmath={"contract", "nsz"},
    error_model="numpy",
)
def run(  # type: ignore[no-untyped-def]
    stiffness,
    rod,
    scalars,
    flags,
    addresses,
    parameters,
    weights,
    times,
    base,
    sensors,
    states,
    work,
    out_torque,
    out_sensor,
    out_tip,
    out_shaft,
    counts,
):
    """Follow the base path from the state in every slot of `states`.

    0 when done, 1 when a step failed, TOO_MANY when it takes more than MOST_SOLVES solves.

    The last state ends up in slot 0. `work` is scratch of zeros, of WORK_ROWS rows.

    Rods that depend on no rate take one implicit step a sample, and none while the base holds still. The
    others take two implicit stages, a diagonally implicit Runge–Kutta method of second order (Alexander,
    SIAM J. Numer. Anal. 14, 1977); what it adds to first order sets the length of the steps. Where slip
    limits have a memory, setting out from an extrapolated state would change what dry friction remembers:
    there two half steps and a full one are taken, and their difference is extrapolated away. Steps end at
    samples, or divide the way to the next one; samples inside a step are read off a quadratic, whose error
    counts too.
    """
    n = states.shape[2]
    samples = times.size
    laws = (addresses, parameters, weights)
    work, states, rod = borrowed(work), borrowed(states), borrowed(rod)
    outputs = (borrowed(out_torque), borrowed(out_sensor), borrowed(out_tip), borrowed(out_shaft))
    work[SPRING, : n - 1] = stiffness
    work[C_ALG] = rod[COMPLIANCE]
    # the base is a stuck node that grips the drive
    work[C_ALG, 0] = scalars[BASE_COMPLIANCE]
    work[UP] = rod[PLUS]
    work[DOWN] = rod[MINUS]
    # `before` is the middle of the last step, or its start where steps are single
    now, before, half, end, full, shown, rate, last_rate = 0, 1, 2, 3, 4, 5, 6, 7
    since = -1.0  # what the base turned or, in a rod that depends on rates, the time from `before` to `now`
    gap = -1.0  # that time where both lie on one line of the base path, else negative
    set_for = -1.0
    tolerance = scalars[TOLERANCE]
    # steps that divide the way to a sample are longer by rounding
    shortest = scalars[SHORTEST] * (1.0 + 1e-6)
    adaptive, dry, halved = flags & ADAPTIVE != 0, flags & HAS_DRY != 0, flags & HAS_BOND != 0
    parts = 3 if halved else 2 if adaptive else 1
    gamma = 0.5 if halved else GAMMA
    shown_nodes = np.append(sensors, n - 1) if out_shaft.shape[0] == 0 else np.arange(n)
    row = -1  # last sample stored
    time = times[0]
    length = min(scalars[LONGEST], 1e-3)
    next_kink = 0
    if base[0] == states[0, GRIP, 0]:
        row = 0
        store(rod, flags, laws, stiffness, states, now, time, 0, sensors, outputs)

    # torque laws move the needle at a base that stands still, once
    at_rest = flags & HAS_LAWS == 0
    while row < samples - 1:
        if counts[SOLVES] > scalars[MOST_SOLVES]:
            counts[FAILED_SAMPLE] = max(row, 0)
            return TOO_MANY
        target = row + 1
        single = not adaptive or row < 0
        middle_time = time
        middle_base = 0.0
        stage = half
        if single:
            if row < 0:
                # the record starts elsewhere than the state: the base turned there within one sample
                dt = times[1] - times[0] if samples > 1 else 1e-3
            elif base[target] == base[row] and at_rest:
                store(rod, flags, laws, stiffness, states, now, times[target], target, sensors, outputs)
                row = target
                time = times[row]
                continue
            else:
                dt = times[target] - time
            stop = times[target]
            end_base = base[target]
        else:
            if row >= next_kink:
                next_kink = end_of_line(times, base, row)
                gap = -1.0
                length = min(length, times[row + 1] - times[row])
            if flags & HAS_BOND:
                turn = abs(base[row + 1] - base[row]) / (times[row + 1] - times[row])
                length = min(length, scalars[LONGEST_SLIP] / (turn + 1e-12))
            to_next = times[target] - time
            if length >= to_next * (1.0 - 1e-9):
                target = furthest_sample(
                    times, base, time, length, row, next_kink, gap > 0.0, flags, tolerance
                )
                stop = times[target]
                dt = stop - time
                end_base = base[target]
            else:
                target = row
                dt = to_next / math.ceil(to_next / length - 1e-9)
                stop = time + dt
                end_base = angle_of_base(times, base, row, stop)
            stage = half if halved else shown
            middle_time = time + gamma * dt
            middle_base = angle_of_base(times, base, row, middle_time)

        solved = True
        for part in range(1 if single else parts):
            # the halves first: their active set is a good first guess for the full step
            if single:
                old, new, guess, h, b, t = now, end, now, dt, end_base, stop
                turn = end_base - states[now, GRIP, 0]
                earlier, ratio = before, turn / since
            elif part == 0:
                old, new, guess, h, b, t = now, stage, now, gamma * dt, middle_base, middle_time
                # longer ago is better: fronts are known to the node only; `end` is still the step's before
                earlier, ratio = end, (1.0 - gamma) * h / gap
            elif part == 1:
                old, new, guess, b, t = stage, end, stage, end_base, stop
                rest = dt - h
                earlier, ratio = (before, rest / (gap + h)) if gap > 0.0 else (now, rest / h)
                if not halved:
                    go_onward(rod, states, now, stage, full, flags)
                    old = full
            else:
                old, new, guess, h, b, t = now, full, end, dt, end_base, stop
                earlier, ratio = end, -1.0
            if ratio > 0.0:
                predict_slip(states, earlier, old, ratio, new)
            else:
                states[new, SLIP] = states[guess, SLIP]
            if h != set_for:
                set_length(rod, flags, h, work)
                set_for = h
            solved = step(rod, scalars, flags, laws, states, old, new, guess, h, b, t, work, counts)
            if not solved:
                break
        if not solved:
            if single or dt <= shortest:
                counts[FAILED_SAMPLE] = max(row, 0)
                return 1
            length = 0.5 * dt
            continue
        if single:
            at_rest = True
            turned = end_base - states[now, GRIP, 0]
            since = turned if turned != 0.0 else -1.0
            before, now, end = now, end, before
        else:
            if not halved:
                conclude(states, now, stage, half, end, full, rate, dt, 3 if dry else 1)
            twist = states[end, ANGLE, 0] - states[end, ANGLE, 1]
            twist -= states[full, ANGLE, 0] - states[full, ANGLE, 1]
            error = max(largest_difference(states, end, full), abs(twist) * stiffness[0] / TORQUE_PER_RAD)
            error /= tolerance
            if error > 1.0 and dt > shortest:
                length = max(scalars[SHORTEST], dt * max(0.2, 0.85 / math.sqrt(error)))
                continue
            if halved:
                extrapolate(rod, states, half, end, full, flags, scalars[AGEING_TIME])
            growth = min(3.0 if halved else 5.0, 0.85 / math.sqrt(max(error, 1e-4)))
            if target > row + 1 and gap > 0.0:
                if halved:
                    missed = missed_by_quadratic(states, before, now, half, end, gap, dt)
                else:
                    base_missed = missed_by_parabola(states, now, stage, last_rate, rate, dt, 0)
                    base_missed -= missed_by_parabola(states, now, stage, last_rate, rate, dt, 1)
                    missed = abs(base_missed) * stiffness[0] / TORQUE_PER_RAD
                    for node in shown_nodes:
                        miss = missed_by_parabola(states, now, stage, last_rate, rate, dt, node)
                        missed = max(missed, abs(miss))
                missed /= tolerance
                needed = target > row + 2 or abs(times[row + 1] - middle_time) > 1e-6 * dt
                if missed > 1.0 and needed:
                    length = dt * max(0.25, 0.85 / missed ** (1.0 / 3.0))
                    continue
                growth = min(growth, max(1.0, 0.85 / max(missed, 1e-4) ** (1.0 / 3.0)))
            if dry and (halved or target > row + 1):
                set_for = -1.0
            if dry and halved:
                set_limits(rod, scalars, states, end, end, 1.0 + LIMIT_TOLERANCE, work)
                if not admit(rod, flags, laws, states, end, half, 0.5 * dt, stop, work, counts):
                    if dt <= shortest:
                        counts[FAILED_SAMPLE] = max(row, 0)
                        return 1
                    length = 0.5 * dt
                    continue
                if target > row + 1:
                    set_limits(rod, scalars, states, now, end, 1.0 + LIMIT_TOLERANCE, work)
            for k in range(row + 1, target):
                x = (times[k] - time) / dt
                blend(states, now, half, end, x, 3 if dry else 1, shown)
                if dry and not admit(rod, flags, laws, states, shown, now, x * dt, times[k], work, counts):
                    counts[FAILED_SAMPLE] = k
                    return 1
                store(rod, flags, laws, stiffness, states, shown, times[k], k, sensors, outputs)
            gap = dt - gamma * dt
            before, half = half, before
            rate, last_rate = last_rate, rate
            now, end = end, now
            length = max(scalars[SHORTEST], min(scalars[LONGEST], dt * growth))
        if target > row:
            store(rod, flags, laws, stiffness, states, now, stop, target, sensors, outputs)
        row = target
        time = stop
    if now != 0:
        states[0] = states[now]
    return 0
