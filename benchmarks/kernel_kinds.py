"""Kinds of rods, solved by the code that PYTHONPATH names: a kind a line in, a result a line out.

A line "NAME TIMES" is answered by processor seconds of one solve and a digest of what it found; "NAME 0" by
the found numbers themselves.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypedDict

import numpy as np

from needle_rig.physics.rod import Layout, Rod, TorqueLaw, build_rod
from needle_rig.physics.solution import Solution
from needle_rig.physics.solver import solve

JG = 62.56e-6
LAYOUT = Layout(
    0.397, ((0.175, 0.2), (0.24, 0.265), (0.305, 0.33), (0.37, 0.395)), (0.22, 0.285, 0.35, 0.397)
)


def bending(parameters: Any, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
    """A steady law: tissue that pulls towards one angle."""
    return float(-parameters[0] * (angle_rad - parameters[1]))


def swaying(parameters: Any, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
    """A law that depends on the time."""
    return float(-parameters[0] * (angle_rad - parameters[1] * math.sin(time_s)))


def rod(
    viscous: float = 0.0,
    stiffness: float = 0.0,
    creep: tuple[float, float] | None = None,
    law: Callable[..., float] | None = None,
    **rows: float,
) -> Rod:
    """The rig's rod with values per 100 mm: N·mm·s, N·mm/rad, creep as (stiffness, viscosity)."""
    plain = build_rod(LAYOUT, JG, 0.0996e-2)
    length = plain.tissue_length_m
    inside = length > 0
    safe = np.where(inside, length, 1.0)
    changes: dict[str, Any] = {"viscous_nms_per_rad": viscous * 1e-2 * length}
    if stiffness:
        changes["compliance_rad_per_nm"] = np.where(inside, 1 / (stiffness * 1e-2 * safe), 0.0)
    if creep:
        changes["creep_stiffness_nm_per_rad"] = np.where(inside, creep[0] * 1e-2 * length, np.inf)
        changes["creep_viscosity_nms_per_rad"] = np.where(inside, creep[1] * 1e-2 * length, np.inf)
    for name, value in rows.items():
        changes[name] = np.where(inside, value, 0.0) if name != "weakening_rad" else value
    if law:
        values = np.array([2e-4, 0.3])
        changes["laws"] = (TorqueLaw(law, values, length, law is bending),)
    return replace(plain, **changes)


class RodValues(TypedDict, total=False):
    """Values of `rod` that differ from the plain one's."""

    viscous: float
    stiffness: float
    creep: tuple[float, float]
    law: Callable[..., float]
    static_excess: float
    weakening_rad: float
    ageing_per_decade: float


KINDS: dict[str, RodValues] = {
    "rigid": {},
    "elastic": {"stiffness": 0.278},
    "viscous": {"viscous": 0.5},
    "viscous elastic": {"viscous": 0.1, "stiffness": 0.278},
    "creep": {"stiffness": 0.278, "creep": (0.3, 1.0)},
    "creep viscous": {"viscous": 0.1, "creep": (0.3, 1.0)},
    "Stribeck": {"stiffness": 0.278, "static_excess": 0.3, "weakening_rad": 1.0},
    "Stribeck viscous": {"stiffness": 0.278, "viscous": 0.05, "static_excess": 0.3, "weakening_rad": 0.3},
    "ageing": {"stiffness": 0.278, "ageing_per_decade": 0.1, "weakening_rad": 0.3},
    "steady law": {"stiffness": 0.278, "law": bending},
    "law of time": {"stiffness": 0.278, "viscous": 0.1, "law": swaying},
}


def drive() -> tuple[np.ndarray, np.ndarray]:
    """The paper's 45° compensation at 50 Hz: times in s, base angles in rad, shapes (samples,)."""
    times, angles = [0.0], [0.0]
    for target in np.radians([45.0, 71.0, 25.5, 51.5, 45.0]):
        times += [times[-1] + abs(target - angles[-1]) / np.radians(45.0)]
        times += [times[-1] + 3.0]
        angles += [target, target]
    grid = np.union1d(np.arange(0.0, times[-1], 0.02), times)
    grid = grid[np.append(True, np.diff(grid) > 1e-6)]
    return grid, np.interp(grid, times, angles)


def numbers(found: Solution) -> np.ndarray:
    """Everything that was found, shape (any,)."""
    state = found.state
    rows = [getattr(state, name) for name in state.__dataclass_fields__]
    return np.concatenate(
        [found.torque_nm, found.sensor_rad.ravel(), found.tip_rad, *rows, [found.steps, found.solves]]
    )


def main() -> None:
    times, base = drive()
    rods = {name: rod(**given) for name, given in KINDS.items()}
    for line in sys.stdin:
        name, _, repeats = line.strip().rpartition(" ")
        if not int(repeats):
            answer: Any = numbers(solve(rods[name], times, base)).tolist()
        else:
            start = time.process_time()
            for _ in range(int(repeats)):
                found = solve(rods[name], times, base)
            spent = time.process_time() - start
            answer = [spent / int(repeats), hashlib.sha256(numbers(found).tobytes()).hexdigest()]
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
