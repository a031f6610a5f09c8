"""What no needle does: each a sentence that says which line of the mapping to look at."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.dataset.records import DatasetTrial, Needle
from needle_rig.importing import signals
from needle_rig.importing.mapping import BASE, TIP_TORQUE, TORQUE
from needle_rig.importing.signals import CLEAR_LAG, CLEAR_WORK
from needle_rig.numerics import Array
from needle_rig.physics.machine import MACHINES, NEEDLE, Machine
from needle_rig.physics.rod import Layout

LEAST_FOLLOWED, MOST_FOLLOWED = 0.02, 1.3
"""Share of the base's travel that a sensor on the needle sees; above 1 by noise and overshoot alone."""
SLOWEST_IN_TRIAL_DEG_S = 0.05
MOVING_SHARE = 0.2
"""Of the largest rate: slower samples are of a reversal, where friction changes."""
LEAST_CARRIED = 0.3
"""Share of the torque on the tip by which that at the base rises: a free shaft gives −1."""
TORQUE_WITHIN = 30.0
"""Factor between the torque and what the twist asks for: friction, a second support and an inexact modulus
make a few; a wrong prefix makes a thousand, N·cm for N·mm ten, which this cannot tell."""


def expected_torque_nm(twist_rad: float, position_m: float, rigidity_nm2: float) -> float:
    """GJ · twist / length: what a shaft free up to `position_m` asks for."""
    return twist_rad * rigidity_nm2 / position_m


@dataclass(frozen=True)
class Problem:
    """What no needle does, and the channel whose line to look at."""

    role: str
    said: str
    of_size: bool = False
    """Too large or too small, which a person can know better; a wrong sign or order is never right."""


def impossible(
    trials: Sequence[DatasetTrial],
    sensors: Sequence[str],
    layout: Layout,
    needle: Needle,
    machine: Machine = MACHINES[NEEDLE],
) -> list[Problem]:
    """Everything that no such machine does, over all trials; empty when there is nothing."""
    base = [t.trial.base_angle_rad - t.trial.base_angle_rad[0] for t in trials]
    found = list(_base(trials, base, machine))
    # friction may hold any line but a needle wound when the recording begins: the sensor's zero counts there
    relaxed = machine is MACHINES[NEEDLE]
    torque = [
        _from_start(t.torque_nm, b) if relaxed else t.torque_nm for t, b in zip(trials, base, strict=True)
    ]
    if any(np.isfinite(x).any() for x in torque):
        work = _weighed([signals.work_share(b, x) for b, x in zip(base, torque, strict=True)], base)
        loaded = any(t.trial.tip_torque_nm is not None for t in trials)
        if loaded:  # which may drive the base
            found += _tip_torque(trials)
        elif work < -CLEAR_WORK:
            found.append(
                Problem(
                    TORQUE,
                    f"base_torque falls while the base winds up: the needle would give {-work:.0%} of "
                    f"the work "
                    "back; turn its sign, or are base_angle and base_torque swapped?",
                )
            )
    for k, name in enumerate(sensors):
        angle = [_from_start(t.hall_rad[:, k], b) for t, b in zip(trials, base, strict=True)]
        if any(np.isfinite(x).sum() > 10 for x in angle):
            found += _sensor(name, base, angle)
    found += _torque_size(base, torque, trials, layout, needle)
    return found


def _base(trials: Sequence[DatasetTrial], base: Sequence[Array], machine: Machine) -> Iterator[Problem]:
    rate = math.degrees(max(signals.peak_rate(t.trial.time_s, b) for t, b in zip(trials, base, strict=True)))
    reach = math.degrees(max(float(np.abs(b).max()) for b in base))
    if reach == 0.0:
        yield Problem(BASE, "base_angle never changes; nothing drives the needle: is it the right column?")
    elif reach > machine.largest_deg or rate > machine.fastest_deg_s:
        yield Problem(
            BASE,
            (
                f"base_angle reaches {reach:.4g}° at {rate:.4g}°/s, limits are {machine.largest_deg:g}° and "
                f"{machine.fastest_deg_s:g}°/s: is it in degrees where the mapping says radians (57.3 times "
                "too large), or is its clock in milliseconds?"
            ),
            of_size=True,
        )
    elif rate < SLOWEST_IN_TRIAL_DEG_S:
        yield Problem(
            BASE,
            (
                f"base_angle turns at {rate:.2g}°/s at most, limit {SLOWEST_IN_TRIAL_DEG_S:g}°/s: is it in "
                "radians where the mapping says degrees, or its clock in seconds where it counts "
                f"milliseconds?"
            ),
            of_size=True,
        )


def _tip_torque(trials: Sequence[DatasetTrial]) -> Iterator[Problem]:
    """The base carries what pushes the tip: at equal angle and direction the base torque falls by as much.

    Told where the torque on the tip changes the base torque by more than all else that is left.
    """
    seen, laws, loads = [], [], []
    for trial in trials:
        given = trial.trial
        if given.tip_torque_nm is None or not trial.torque_ok.any():
            continue
        rate = np.gradient(given.base_angle_rad, given.time_s)
        moving = trial.torque_ok & (np.abs(rate) > MOVING_SHARE * np.abs(rate).max())
        seen.append(trial.torque_nm[moving])
        angle = given.base_angle_rad[moving]
        laws.append(np.column_stack([np.ones_like(angle), np.sign(rate[moving]), angle]))
        loads.append(given.tip_torque_nm[moving])
    if not seen:
        return
    y, x, load = np.concatenate(seen), np.vstack(laws), np.concatenate(loads)
    y, load = (v - x @ np.linalg.lstsq(x, v, rcond=None)[0] for v in (y, load))
    power = float(load @ load)
    carried = float(load @ y) / power if power > 0.0 else 0.0
    left = float(((y - carried * load) ** 2).sum())
    if carried > LEAST_CARRIED and carried**2 * power > left:
        yield Problem(
            TIP_TORQUE,
            (
                f"base_torque rises by {carried:.2g} of the torque on the tip, which it carries: the sum of"
                " both would turn the shaft; turn the sign of tip_torque, which is positive where it "
                f"turns the"
                " needle counter-clockwise"
            ),
        )


def _from_start(values: Array, base: Array) -> Array:
    begin = values[: signals.rest_before_motion(base)]
    known = begin[np.isfinite(begin)]
    return values - (known.mean() if len(known) else 0.0)


def _weighed(shares: Sequence[float], base: Sequence[Array]) -> float:
    """Mean over trials, each by the way of its base."""
    ways = [float(np.abs(np.diff(b)).sum()) for b in base]
    return float(np.average(shares, weights=ways)) if sum(ways) > 0 else 0.0


def _sensor(name: str, base: Sequence[Array], angle: Sequence[Array]) -> Iterator[Problem]:
    travel = max(float(np.ptp(b)) for b in base)
    span = max(float(np.ptp(a[np.isfinite(a)])) if np.isfinite(a).any() else 0.0 for a in angle)
    follow = _weighed([signals.follow_sign(b, a) for b, a in zip(base, angle, strict=True)], base)
    lag = _weighed([signals.lag_share(b, _filled(a)) for b, a in zip(base, angle, strict=True)], base)
    share = span / travel if travel else 0.0
    if share > MOST_FOLLOWED:
        yield Problem(
            name,
            (
                f"{name} turns {share:.3g} times as far as the base: is it in degrees where the mapping says "
                "radians (57.3 times), or is another column the base?"
            ),
            of_size=True,
        )
    elif share < LEAST_FOLLOWED and share > 0:
        yield Problem(
            name,
            (
                f"{name} turns {share:.2g} of what the base does: is it in radians where the mapping says "
                "degrees, or no angle of the needle?"
            ),
            of_size=True,
        )
    elif follow < -0.5:
        yield Problem(name, f"{name} turns against the base; turn its sign")
    elif lag < -CLEAR_LAG:
        yield Problem(
            name,
            (
                f"{name} moves before the base, which lags it by {-lag:.2g} of a loop: are the columns "
                f"swapped, "
                "or the clocks off (offset_s)?"
            ),
        )


def _filled(values: Array) -> Array:
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), known, values[known]) if len(known) else values


def _torque_size(
    base: Sequence[Array],
    torque: Sequence[Array],
    trials: Sequence[DatasetTrial],
    layout: Layout,
    needle: Needle,
) -> Iterator[Problem]:
    seen = max((float(np.ptp(x[np.isfinite(x)])) for x in torque if np.isfinite(x).any()), default=0.0)
    if seen == 0.0 or not layout.tissue_sections_m or not needle.rigidity_is_known:
        return
    rigidity = needle.torsional_rigidity_nm2
    first = layout.tissue_sections_m[0][0]
    travel = max(float(np.ptp(b)) for b in base)
    if first > 0:
        most = expected_torque_nm(travel, first, rigidity)
        if seen > TORQUE_WITHIN * most:
            yield Problem(
                TORQUE,
                (
                    f"base_torque spans {seen * 1e3:.3g} N·mm, where a needle held at its first tissue gives "
                    f"{most * 1e3:.2g} N·mm: is it in N·mm where the mapping says N·m, or the rigidity wrong?"
                ),
                of_size=True,
            )
            return
    if not layout.sensor_positions_m or min(layout.sensor_positions_m) <= 0:
        return
    nearest = int(np.argmin(layout.sensor_positions_m))
    twists = [b - _from_start(t.hall_rad[:, nearest], b) for b, t in zip(base, trials, strict=True)]
    twist = max((float(np.ptp(x[np.isfinite(x)])) for x in twists if np.isfinite(x).any()), default=0.0)
    if twist < math.radians(3.0):
        return
    least = expected_torque_nm(twist, layout.sensor_positions_m[nearest], rigidity)
    if seen < least / TORQUE_WITHIN:
        yield Problem(
            TORQUE,
            (
                f"base_torque spans {seen * 1e3:.3g} N·mm, where the twist asks for {least * 1e3:.2g} "
                f"N·mm: is "
                "it in N·m where the mapping says N·mm, or the rigidity wrong?"
            ),
            of_size=True,
        )
