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

from needle_rig.physics.laws import call_law

# rows of `coefficients` (Rod.coefficients)
PLUS, MINUS, COMPLIANCE, CREEP_K, CREEP_ETA, VISCOUS, EXCESS, AGEING, POSITION = range(9)
# rows of a state: angle, grip, creep, bond, age, slip direction
ANGLE, GRIP, CREEP, BOND, AGE, SLIP = range(6)
# scalars
BASE_COMPLIANCE, STRIBECK_RATE, WEAKENING, AGEING_TIME, TOLERANCE, LONGEST, SHORTEST = range(7)
# counts
STEPS, SOLVES, FAILED_NODE, FAILED_SAMPLE, FIRST_WRONG, LAST_WRONG = range(6)
# flags
HAS_CREEP, HAS_VISCOUS, HAS_BOND, ADAPTIVE = 1, 2, 4, 8
# rows of the work array
(
    LEFT, RIGHT, C_ALG, DAMP, GRIP0, UP, DOWN, SLIP_PLUS, SLIP_MINUS, FORCE, SLOPE,
    LOW, SHIFT, TORQUE, MOVE, NEXT, ALPHA,
) = range(17)  # fmt: skip
WORK_ROWS = 17

EPS = 2.220446049250313e-16
MOVE_TOLERANCE_RAD = 1e-11
MOST_BLOCK_FLIPS = 60
MOST_NEWTON = 20
SOFTENED_RAD = 1e-8
SMALL_LOAD = 1e-9
"""Part of a node's limits below which a shed load is not followed further."""

_jit = njit(cache=True, nogil=True, fastmath={"contract", "nsz"}, error_model="numpy")


@_jit
def sweep(base_compliance, base, slip, work, angle):  # type: ignore[no-untyped-def]
    """Solve the linear system of the present active set into `angle`.

    The tridiagonal system is eliminated from both ends to the middle, which halves the chain of divisions;
    rows are put together on the way, in the shadow of the divisions. Indices are unsigned because numba
    otherwise tests each for counting from the end.
    """
    n = slip.size
    middle = n // 2
    low, shift = work[LOW], work[SHIFT]
    # row 0 is the base: θ + base_compliance · (Kθ − f) = base
    above = -base_compliance * work[RIGHT, 0]
    inverse = 1.0 / (1.0 - above)
    ratio = above * inverse
    value = (base + base_compliance * work[FORCE, 0]) * inverse
    low[0] = ratio
    shift[0] = value
    last = np.uintp(n - 1)
    below, diagonal, above, given = row(last, slip, work)
    inverse = 1.0 / diagonal
    ratio_j = below * inverse
    value_j = given * inverse
    low[last] = ratio_j
    shift[last] = value_j
    pairs = min(middle - 1, n - 2 - middle)
    for k in range(1, pairs + 1):
        i = np.uintp(k)
        j = np.uintp(n - 1 - k)
        below, diagonal, above, given = row(i, slip, work)
        below_j, diagonal_j, above_j, given_j = row(j, slip, work)
        inverse = 1.0 / (diagonal - below * ratio)
        inverse_j = 1.0 / (diagonal_j - above_j * ratio_j)
        ratio = above * inverse
        ratio_j = below_j * inverse_j
        value = (given - below * value) * inverse
        value_j = (given_j - above_j * value_j) * inverse_j
        low[i] = ratio
        low[j] = ratio_j
        shift[i] = value
        shift[j] = value_j
    for k in range(pairs + 1, middle):
        i = np.uintp(k)
        below, diagonal, above, given = row(i, slip, work)
        inverse = 1.0 / (diagonal - below * ratio)
        ratio = above * inverse
        value = (given - below * value) * inverse
        low[i] = ratio
        shift[i] = value
    for k in range(pairs + 1, n - 1 - middle):
        j = np.uintp(n - 1 - k)
        below, diagonal, above, given = row(j, slip, work)
        inverse = 1.0 / (diagonal - above * ratio_j)
        ratio_j = below * inverse
        value_j = (given - above * value_j) * inverse
        low[j] = ratio_j
        shift[j] = value_j
    x = 0.0
    if middle == n - 1:
        # two nodes: the upward elimination has reached the middle already
        x = (shift[middle] - low[middle] * value) / (1.0 - low[middle] * ratio)
    else:
        below, diagonal, above, given = row(np.uintp(middle), slip, work)
        x = (given - below * value - above * value_j) / (diagonal - below * ratio - above * ratio_j)
    x_j = x
    angle[middle] = x
    for k in range(1, min(middle, n - 1 - middle) + 1):
        i = np.uintp(middle - k)
        j = np.uintp(middle + k)
        x = shift[i] - low[i] * x
        x_j = shift[j] - low[j] * x_j
        angle[i] = x
        angle[j] = x_j
    if n - 1 - middle < middle:
        angle[0] = shift[0] - low[0] * x


@_jit
def row(i, slip, work):  # type: ignore[no-untyped-def]
    """Row i of the linear system: below, on and above the diagonal, and the right side."""
    state = slip[i]
    stuck = state == 0.0
    scale = work[C_ALG, i] if stuck else 1.0
    own = 1.0 if stuck else work[DAMP, i]
    given = work[GRIP0, i] if stuck else (work[SLIP_MINUS, i] if state < 0.0 else work[SLIP_PLUS, i])
    left = work[LEFT, i]
    right = work[RIGHT, i]
    return (
        -scale * left,
        scale * (left + right - work[SLOPE, i]) + own,
        -scale * right,
        scale * work[FORCE, i] + given,
    )


@_jit
def contradictions(angle, slip, work, counts):  # type: ignore[no-untyped-def]
    """Torque and slip of every node, and how many contradict their state.

    NEXT says which way they want to go; the first and last of them are counted too.
    """
    n = slip.size
    torque, move, nxt = work[TORQUE], work[MOVE], work[NEXT]
    bad = 0
    here = angle[0]
    after = angle[1]
    for i in range(1, n):
        before = here
        here = after
        if i < n - 1:
            after = angle[np.uintp(i + 1)]
        left = work[LEFT, i]
        right = work[RIGHT, i]
        state = slip[i]
        wrong = 0.0
        if state == 0.0:
            hold = left * (before - here) + right * (after - here) + (work[FORCE, i] + work[SLOPE, i] * here)
            torque[i] = hold
            move[i] = 0.0
            rounding = 32.0 * EPS * (left + right) * (abs(here) + 1e-3)
            if hold > work[UP, i] * (1.0 + 1e-9) + rounding:
                wrong = 1.0
            elif hold < -work[DOWN, i] * (1.0 + 1e-9) - rounding:
                wrong = -1.0
        else:
            given = work[SLIP_MINUS, i] if state < 0.0 else work[SLIP_PLUS, i]
            resist = work[DAMP, i] * here - given
            slipped = here - work[GRIP0, i] - work[C_ALG, i] * resist
            torque[i] = resist
            move[i] = slipped
            if state * slipped < -MOVE_TOLERANCE_RAD and state < 2.0:
                wrong = -state
        nxt[i] = wrong
        if wrong != 0.0:
            if bad == 0:
                counts[FIRST_WRONG] = i
            counts[LAST_WRONG] = i
            bad += 1
    return bad


@_jit
def reach(work, i):  # type: ignore[no-untyped-def]
    """How much of the load that node i sheds goes on to the next one.

    1 in rigid tissue, near 0 where the compliance of stuck or the viscosity of slipping tissue spreads it.
    """
    k = work[LEFT, i]
    q = work[DAMP, i] / k
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
    torque, nxt, carried = work[TORQUE], work[NEXT], work[SHIFT]
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
        start = last + 1


@_jit
def pulled_from_left(work, angle, before, i, sign):  # type: ignore[no-untyped-def]
    """Whether the torque that node i cannot hold came from the base's side since the step began."""
    own = angle[i] - before[i]
    left = work[LEFT, i] * (angle[i - 1] - before[i - 1] - own)
    right = work[RIGHT, i] * (angle[i + 1] - before[i + 1] - own) if i < angle.size - 1 else 0.0
    return sign * left > sign * right


@_jit
def evaluate_laws(addresses, parameters, weights, position, angle, before, dt, time, work):  # type: ignore[no-untyped-def]
    """Linearise the torque laws about `angle`: work[FORCE] + work[SLOPE] · θ. Largest change at `angle`."""
    force, slope = work[FORCE], work[SLOPE]
    change = 0.0
    for i in range(angle.size):
        value = 0.0
        gradient = 0.0
        rate = (angle[i] - before[i]) / dt
        for k in range(addresses.size):
            weight = weights[k, i]
            if weight == 0.0:
                continue
            a, p, x = addresses[k], parameters[k], position[i]
            here = call_law(a, p, angle[i], rate, time, x)
            by_angle = (call_law(a, p, angle[i] + 1e-7, rate, time, x) - here) / 1e-7
            step = 1e-7 * (1.0 + abs(rate))
            by_rate = (call_law(a, p, angle[i], rate + step, time, x) - here) / step
            value += weight * here
            gradient += weight * (by_angle + by_rate / dt)
        change = max(change, abs(force[i] + slope[i] * angle[i] - value))
        force[i] = value - gradient * angle[i]
        slope[i] = gradient
    return change


@_jit
def set_length(rod, flags, dt, work):  # type: ignore[no-untyped-def]
    """Coefficients of creep and viscosity for steps of length dt."""
    if flags & HAS_CREEP:
        for i in range(rod.shape[1]):
            k, eta = rod[CREEP_K, i], rod[CREEP_ETA, i]
            creeps = k < np.inf and eta < np.inf
            work[ALPHA, i] = eta / (eta + dt * k) if creeps else 0.0
            work[C_ALG, i] = rod[COMPLIANCE, i] + (dt / (eta + dt * k) if creeps else 0.0)
    if flags & HAS_VISCOUS:
        for i in range(rod.shape[1]):
            work[DAMP, i] = rod[VISCOUS, i] / (dt + work[C_ALG, i] * rod[VISCOUS, i])


@_jit
def predict_slip(earlier, now, ratio, guess):  # type: ignore[no-untyped-def]
    """The active set if every slip front goes on moving as it did from `earlier` to `now`, times `ratio`.

    Just `now` when fronts have appeared or vanished between the two. Nodes of state 2 have no say.
    """
    n = np.uintp(now.size)
    one = np.uintp(1)
    guess[:] = now
    i = one
    while i < n and earlier[i] == now[i]:
        i += one
    if i == n:
        return
    i, j, place = one, one, one
    while True:
        while i < n and earlier[i] == 2.0:
            i += one
        while j < n and now[j] == 2.0:
            j += one
        if i == n or j == n or earlier[i] != now[j]:
            if i != n or j != n:
                guess[:] = now
            return
        state = now[j]
        while i < n and (earlier[i] == state or earlier[i] == 2.0):
            i += one
        while j < n and (now[j] == state or now[j] == 2.0):
            j += one
        end = n
        if i < n or j < n:
            moved = ratio * (float(j) - float(i))
            end = np.uintp(min(float(n), max(float(place), math.floor(float(j) + moved + 0.5))))
        for k in range(place, end):
            m = np.uintp(k)
            if now[m] != 2.0:
                guess[m] = state
        place = end


@_jit
def step(  # type: ignore[no-untyped-def]
    rod, scalars, flags, addresses, parameters, weights, old, new, guess, dt, base, time, work, counts
):
    """One implicit step of length dt from `old` to `new`, whose slip holds the active set to try first.

    False: no solution. Rows of `new` that this rod does not change (bond, age, creep) are left alone.
    """
    n = old.shape[1]
    compliance = rod[COMPLIANCE]
    alpha, c_alg, grip = work[ALPHA], work[C_ALG], work[GRIP0]
    has_creep = flags & HAS_CREEP != 0
    has_bond = flags & HAS_BOND != 0
    if addresses.size > 0:
        new[ANGLE] = guess[ANGLE]
        evaluate_laws(addresses, parameters, weights, rod[POSITION], new[ANGLE], old[ANGLE], dt, time, work)
    if has_creep:
        for i in range(n):
            grip[i] = old[GRIP, i] + alpha[i] * old[CREEP, i]
    else:
        grip[:] = old[GRIP]
    counts[STEPS] += 1
    if has_bond:
        new[BOND] = old[BOND]
        new[AGE] = old[AGE]
        for _ in range(60):
            for i in range(n):
                factor = 1.0 + rod[EXCESS, i] * new[BOND, i]
                if rod[AGEING, i] > 0.0:
                    factor += rod[AGEING, i] * math.log10(1.0 + new[AGE, i] / scalars[AGEING_TIME])
                work[UP, i] = rod[PLUS, i] * factor
                work[DOWN, i] = rod[MINUS, i] * factor
            limits(work, n)
            if not balance(
                rod, scalars, addresses, parameters, weights, old, new, guess, dt, base, time, work, counts
            ):
                return False
            if follow_bond(rod, scalars, old, new, dt, work[MOVE]) < 1e-6:
                break
    else:
        limits(work, n)
        if not balance(
            rod, scalars, addresses, parameters, weights, old, new, guess, dt, base, time, work, counts
        ):
            return False
    move, torque = work[MOVE], work[TORQUE]
    for i in range(1, n):
        new[GRIP, i] = old[GRIP, i] + move[i]
    new[GRIP, 0] = base
    if has_creep:
        for i in range(1, n):
            new[CREEP, i] = alpha[i] * old[CREEP, i] + (c_alg[i] - compliance[i]) * torque[i]
    return True


@_jit
def limits(work, n):  # type: ignore[no-untyped-def]
    """Right sides of slipping rows for the present slip limits."""
    damp, grip, c_alg = work[DAMP], work[GRIP0], work[C_ALG]
    for i in range(n):
        work[SLIP_PLUS, i] = damp[i] * (grip[i] + c_alg[i] * work[UP, i]) - work[UP, i]
    for i in range(n):
        work[SLIP_MINUS, i] = damp[i] * (grip[i] - c_alg[i] * work[DOWN, i]) + work[DOWN, i]


@_jit
def follow_bond(rod, scalars, old, new, dt, move):  # type: ignore[no-untyped-def]
    """Bond and age at the end of a step with slip `move`; returns the largest change of the limit."""
    change = 0.0
    for i in range(1, move.size):
        if rod[EXCESS, i] > 0.0:
            slipped = abs(move[i])
            ratio = slipped / (dt * scalars[STRIBECK_RATE])
            gain = (slipped + dt * scalars[STRIBECK_RATE]) / scalars[WEAKENING]
            target = math.exp(-ratio * ratio)
            bond = (old[BOND, i] + gain * target) / (1.0 + gain)
            change = max(change, rod[EXCESS, i] * abs(bond - new[BOND, i]))
            new[BOND, i] = bond
        if rod[AGEING, i] > 0.0:
            age = (old[AGE, i] + dt) / (1.0 + abs(move[i]) / scalars[WEAKENING])
            shift = math.log10((scalars[AGEING_TIME] + age) / (scalars[AGEING_TIME] + new[AGE, i]))
            change = max(change, rod[AGEING, i] * abs(shift))
            new[AGE, i] = age
    return change


@_jit
def balance(  # type: ignore[no-untyped-def]
    rod, scalars, addresses, parameters, weights, old, new, guess, dt, base, time, work, counts
):
    """Solve the step's complementarity problem for fixed slip limits; False when it did not converge.

    Where the active set in `new` leads nowhere, that of `guess` is tried. In rigid tissue the correction of
    the active set can go in circles where nodes are about to slip: a pre-sliding give of `SOFTENED_RAD`
    at the limit, in this step alone, breaks them; no grip moves by it.
    """
    n = new.shape[1]
    if settle(rod, scalars, addresses, parameters, weights, old, new, dt, base, time, work, counts, 0, False):
        return True
    new[SLIP] = guess[SLIP]
    if addresses.size > 0:
        new[ANGLE] = guess[ANGLE]
    if settle(
        rod,
        scalars,
        addresses,
        parameters,
        weights,
        old,
        new,
        dt,
        base,
        time,
        work,
        counts,
        MOST_BLOCK_FLIPS,
        False,
    ):
        return True
    kept = work[C_ALG].copy()
    damp = work[DAMP].copy()
    for i in range(1, n):
        largest = max(work[UP, i], work[DOWN, i])
        if 0.0 < largest < np.inf:
            work[C_ALG, i] = max(kept[i], SOFTENED_RAD / largest)
            work[DAMP, i] = damp[i] / (1.0 + (work[C_ALG, i] - kept[i]) * damp[i])
    limits(work, n)
    solved = settle(
        rod,
        scalars,
        addresses,
        parameters,
        weights,
        old,
        new,
        dt,
        base,
        time,
        work,
        counts,
        MOST_BLOCK_FLIPS,
        True,
    )
    work[C_ALG] = kept
    work[DAMP] = damp
    return solved


@_jit
def settle(  # type: ignore[no-untyped-def]
    rod, scalars, addresses, parameters, weights, old, new, dt, base, time, work, counts, eager, to_the_end
):
    """Correct the active set until no node contradicts it; gives up early unless `to_the_end`.

    Laws are linearised anew before each of the first `eager` solves, which strong ones need; after that only
    when the active set has settled, which takes fewer calls and cannot chase it round.
    """
    n = old.shape[1]
    angle, slip = new[ANGLE], new[SLIP]
    nxt = work[NEXT]
    has_laws = addresses.size > 0
    best = n + 1
    stalled = 0
    newton = 0
    for iteration in range(MOST_BLOCK_FLIPS + 20 * n):
        if has_laws and iteration < eager:
            evaluate_laws(addresses, parameters, weights, rod[POSITION], angle, old[ANGLE], dt, time, work)
        sweep(scalars[BASE_COMPLIANCE], base, slip, work, angle)
        counts[SOLVES] += 1
        bad = contradictions(angle, slip, work, counts)
        if bad == 0:
            if not has_laws:
                return True
            # Newton on the laws: the linearisation must meet the laws at the new angles
            change = evaluate_laws(
                addresses, parameters, weights, rod[POSITION], angle, old[ANGLE], dt, time, work
            )
            largest = 0.0
            for i in range(n):
                largest = max(largest, abs(work[FORCE, i] + work[SLOPE, i] * angle[i]))
            if change <= 1e-9 * largest + 1e-18:
                return True
            best = n + 1
            stalled = 0
            newton += 1
            if newton > MOST_NEWTON and not to_the_end:
                return False
            continue
        if bad < best:
            best = bad
            stalled = 0
        else:
            stalled += 1
        if stalled > 2 and not to_the_end:
            return False
        if stalled < 6:
            correct(angle, old[ANGLE], slip, work, counts)
        else:
            # Murty: one flip at a time, always the last in order; finite for every P-matrix
            for i in range(n - 1, 0, -1):
                if nxt[i] != 0.0:
                    slip[i] = nxt[i] if slip[i] == 0.0 else 0.0
                    break
    for i in range(1, n):
        if nxt[i] != 0.0:
            counts[FAILED_NODE] = i
            break
    return False


@_jit
def store(state, torque, row, sensors, out_torque, out_sensor, out_tip, out_shaft):  # type: ignore[no-untyped-def]
    """Write one output sample."""
    out_torque[row] = torque
    for s in range(sensors.size):
        out_sensor[row, s] = state[ANGLE, sensors[s]]
    n = state.shape[1]
    out_tip[row] = state[ANGLE, n - 1]
    if out_shaft.shape[0] > 0:
        out_shaft[row] = state[ANGLE]


@_jit
def base_torque(stiffness, state, addresses, parameters, weights, rod, time):  # type: ignore[no-untyped-def]
    """Torque that the base exerts on the needle."""
    torque = stiffness[0] * (state[ANGLE, 0] - state[ANGLE, 1])
    for k in range(addresses.size):
        if weights[k, 0] != 0.0:
            torque -= weights[k, 0] * call_law(
                addresses[k], parameters[k], state[ANGLE, 0], 0.0, time, rod[POSITION, 0]
            )
    return torque


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
def furthest_sample(times, base, time, length, row, next_kink, has_earlier, tolerance):  # type: ignore[no-untyped-def]
    """The last sample that a step of `length` may reach.

    While the base moves a sensor can start or stop between two samples, so that no sample may lie inside a
    step, save in its middle, where a half step ends.
    """
    target = row + 1
    while target < next_kink and times[target + 1] - time <= length * (1.0 + 1e-9):
        still = abs(base[target + 1] - base[row]) <= 10.0 * tolerance
        if not (has_earlier and still):
            if target == row + 1 and abs(times[row + 2] + time - 2.0 * times[row + 1]) <= 1e-6 * length:
                target += 1
            break
        target += 1
    return target


@_jit
def extrapolate(half, end, full, flags):  # type: ignore[no-untyped-def]
    """Take the error of first order out of the states after one and two half steps."""
    n = half.shape[1]
    for r in range(2):
        for i in range(n):
            shift = end[r, i] - full[r, i]
            half[r, i] += 0.5 * shift
            end[r, i] += shift
    if flags & HAS_CREEP:
        for i in range(n):
            shift = end[CREEP, i] - full[CREEP, i]
            half[CREEP, i] += 0.5 * shift
            end[CREEP, i] += shift
    if flags & HAS_BOND:
        for i in range(n):
            end[BOND, i] = min(1.0, max(0.0, 2.0 * end[BOND, i] - full[BOND, i]))
            end[AGE, i] = max(0.0, 2.0 * end[AGE, i] - full[AGE, i])


@njit(cache=True, nogil=True, fastmath=True)
def largest_difference(a, b):  # type: ignore[no-untyped-def]
    """Largest |a − b|."""
    largest = 0.0
    for i in range(a.size):
        largest = max(largest, abs(a[i] - b[i]))
    return largest


@njit(cache=True, nogil=True, fastmath=True)
def missed_by_quadratic(earlier, now, half, end, earlier_time, time, dt):  # type: ignore[no-untyped-def]
    """Largest error of a quadratic through a step, from the next divided difference."""
    before = time - earlier_time
    worst = 0.0
    for i in range(earlier.size):
        y1, y2, y3 = now[ANGLE, i], half[ANGLE, i], end[ANGLE, i]
        first = (y2 - y1) / (0.5 * dt)
        second = (y3 - y2) / (0.5 * dt)
        bend = (first - (y1 - earlier[i]) / before) / (before + 0.5 * dt)
        worst = max(worst, abs((second - first) / dt - bend))
    return worst / (before + dt) * 0.0481 * dt**3


@_jit
def blend(start, half, end, x, out):  # type: ignore[no-untyped-def]
    """Angles at the fraction x of a step, on a quadratic through its start, middle and end."""
    w0, w1, w2 = (2.0 * x - 1.0) * (x - 1.0), 4.0 * x * (1.0 - x), x * (2.0 * x - 1.0)
    for i in range(start.shape[1]):
        out[ANGLE, i] = w0 * start[ANGLE, i] + w1 * half[ANGLE, i] + w2 * end[ANGLE, i]


@njit(
    "int64(float64[::1], float64[:, ::1], float64[::1], int64, int64[::1], int64[::1], float64[:, ::1],"
    " float64[::1], float64[::1], int64[::1], float64[:, ::1], float64[::1], float64[:, ::1], float64[::1],"
    " float64[:, ::1], int64[::1])",
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
    state,
    out_torque,
    out_sensor,
    out_tip,
    out_shaft,
    counts,
):
    """Follow the base path from `state`, which is advanced in place; 0 when done, 1 when a step failed.

    Rods that depend on no rate take one implicit step a sample, and none while the base holds still. The
    others take two half steps and a full one: their difference is the error of the step, and extrapolating
    it away keeps what is exact and gives second order to the rest. Steps end at samples, or divide the way
    to the next one; samples inside a step are read off a quadratic, whose error counts too.
    """
    n = state.shape[1]
    samples = times.size
    work = np.zeros((WORK_ROWS, n))
    work[RIGHT, : n - 1] = stiffness
    work[LEFT, 1:] = stiffness
    work[C_ALG] = rod[COMPLIANCE]
    work[UP] = rod[PLUS]
    work[DOWN] = rod[MINUS]
    states = np.empty((5, 6, n))
    for k in range(5):
        states[k] = state
    now, half, end, full, shown = states[0], states[1], states[2], states[3], states[4]
    earlier = np.empty(n)
    has_earlier = False
    earlier_time = 0.0
    fronts = np.empty(n)  # slip at the middle of the last step
    fronts_time = -1.0  # from that middle to its end; negative without one
    set_for = -1.0
    tolerance = scalars[TOLERANCE]
    shortest = scalars[SHORTEST]
    adaptive = flags & ADAPTIVE != 0
    row = -1  # last sample stored
    time = times[0]
    length = min(scalars[LONGEST], 1e-3)
    next_kink = 0
    torque = base_torque(stiffness, now, addresses, parameters, weights, rod, time)
    if base[0] == now[GRIP, 0]:
        row = 0
        store(now, torque, 0, sensors, out_torque, out_sensor, out_tip, out_shaft)

    while row < samples - 1:
        target = row + 1
        single = not adaptive or row < 0
        middle_time = time
        middle_base = 0.0
        if single:
            if row < 0:
                # the record starts elsewhere than the state: the base turned there within one sample
                dt = times[1] - times[0] if samples > 1 else 1e-3
            elif base[target] == base[row]:
                store(now, torque, target, sensors, out_torque, out_sensor, out_tip, out_shaft)
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
                has_earlier = False
                fronts_time = -1.0
                length = min(length, times[row + 1] - times[row])
            if flags & HAS_BOND:
                # over a slip of the weakening length the limit changes by as much as it can
                turn = abs(base[row + 1] - base[row]) / (times[row + 1] - times[row])
                length = min(length, scalars[WEAKENING] / (8.0 * turn + 1e-12))
            to_next = times[target] - time
            if length >= to_next * (1.0 - 1e-9):
                target = furthest_sample(times, base, time, length, row, next_kink, has_earlier, tolerance)
                stop = times[target]
                dt = stop - time
                end_base = base[target]
            else:
                target = row
                dt = to_next / math.ceil(to_next / length - 1e-9)
                stop = time + dt
                end_base = angle_of_base(times, base, row, stop)
            middle_time = time + 0.5 * dt
            middle_base = angle_of_base(times, base, row, middle_time)

        solved = True
        for part in range(1 if single else 3):
            # the halves first: their active set is a good first guess for the full step
            if single:
                old, new, guess, h, b, t = 0, 2, 0, dt, end_base, stop
            elif part == 0:
                old, new, guess, h, b, t = 0, 1, 0, 0.5 * dt, middle_base, middle_time
            elif part == 1:
                old, new, guess, h, b, t = 1, 2, 1, 0.5 * dt, end_base, stop
            else:
                old, new, guess, h, b, t = 0, 3, 2, dt, end_base, stop
            if part == 0 and not single and fronts_time > 0.0:
                predict_slip(fronts, now[SLIP], h / fronts_time, states[new, SLIP])
            elif part == 1:
                predict_slip(now[SLIP], half[SLIP], 1.0, end[SLIP])
            else:
                states[new, SLIP] = states[guess, SLIP]
            if h != set_for:
                set_length(rod, flags, h, work)
                set_for = h
            solved = step(
                rod, scalars, flags, addresses, parameters, weights,
                states[old], states[new], states[guess], h, b, t, work, counts,
            )  # fmt: skip
            if not solved:
                break
        if not solved:
            if single or dt <= shortest:
                counts[FAILED_SAMPLE] = max(row, 0)
                return 1
            length = 0.5 * dt
            continue
        if not single:
            error = largest_difference(end[ANGLE], full[ANGLE]) / tolerance
            if error > 1.0 and dt > shortest:
                length = dt * max(0.2, 0.85 / math.sqrt(error))
                continue
            extrapolate(half, end, full, flags)
            growth = min(3.0, 0.85 / math.sqrt(max(error, 1e-4)))
            if target > row + 1 and has_earlier:
                missed = missed_by_quadratic(earlier, now, half, end, earlier_time, time, dt) / tolerance
                needed = target > row + 2 or abs(times[row + 1] - middle_time) > 1e-6 * dt
                if missed > 1.0 and needed:
                    length = dt * max(0.25, 0.85 / missed ** (1.0 / 3.0))
                    continue
                growth = min(growth, max(1.0, 0.85 / max(missed, 1e-4) ** (1.0 / 3.0)))
            for k in range(row + 1, target):
                blend(now, half, end, (times[k] - time) / dt, shown)
                torque = base_torque(stiffness, shown, addresses, parameters, weights, rod, times[k])
                store(shown, torque, k, sensors, out_torque, out_sensor, out_tip, out_shaft)
            earlier[:] = half[ANGLE]
            earlier_time = middle_time
            has_earlier = True
            fronts[:] = half[SLIP]
            fronts_time = 0.5 * dt
            length = min(scalars[LONGEST], dt * growth)
        now[:] = end
        if target > row:
            torque = base_torque(stiffness, now, addresses, parameters, weights, rod, stop)
            store(now, torque, target, sensors, out_torque, out_sensor, out_tip, out_shaft)
        row = target
        time = stop
    state[:] = now
    return 0
