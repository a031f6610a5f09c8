"""Rods, paths and comparisons that the physics tests share."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from needle_rig.physics.rod import Layout, Rod, build_rod
from needle_rig.physics.solution import Solution

JG = 62.56e-6
EXPERIMENT = Layout(
    0.397, ((0.175, 0.2), (0.24, 0.265), (0.305, 0.33), (0.37, 0.395)), (0.22, 0.285, 0.35, 0.397)
)
MODEL = Layout(0.275, ((0.175, 0.275),), (0.275,))


def rod(
    *,
    friction: float = 0.0996,
    viscous: float = 0.0,
    stiffness: float = np.inf,
    creep: tuple[float, float] | None = None,
    layout: Layout = EXPERIMENT,
    element_length_m: float = 0.5e-3,
    **fields: Any,
) -> Rod:
    """A rod from values per 100 mm: N·mm, N·mm·s, N·mm/rad, creep as (stiffness, viscosity)."""
    plain = build_rod(layout, JG, friction * 1e-2, element_length_m)
    length = plain.tissue_length_m
    inside = length > 0
    safe = np.where(inside, length, 1.0)
    changes: dict[str, Any] = {"viscous_nms_per_rad": viscous * 1e-2 * length}
    if np.isfinite(stiffness):
        changes["compliance_rad_per_nm"] = np.where(inside, 1 / (stiffness * 1e-2 * safe), 0.0)
    if creep is not None:
        changes["creep_stiffness_nm_per_rad"] = np.where(inside, creep[0] * 1e-2 * length, np.inf)
        changes["creep_viscosity_nms_per_rad"] = np.where(inside, creep[1] * 1e-2 * length, np.inf)
    for name, value in fields.items():
        is_row = name in ("static_excess", "ageing_per_decade")
        changes[name] = np.where(inside, value, 0.0) if is_row else value
    return replace(plain, **changes)


def lumped(node_name: str, torque_nmm: float, **options: Any) -> Rod:
    """A rod with friction on one node."""
    plain = rod(**options)
    node = getattr(plain, node_name)
    limit = plain.slip_plus_nm.copy()
    limit[node] += torque_nmm * 1e-3
    return replace(plain, slip_plus_nm=limit, slip_minus_nm=limit)


def path(
    targets_deg: list[float], rate_deg_s: float = 45.0, settle_s: float = 3.0, sample_hz: float = 50.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times and base angles of motions at constant rate, each followed by a hold."""
    time, angle = [0.0], [0.0]
    for target in targets_deg:
        time.append(time[-1] + max(abs(target - angle[-1]) / rate_deg_s, 1e-3))
        angle.append(target)
        time.append(time[-1] + settle_s)
        angle.append(target)
    grid = np.arange(0.0, time[-1], 1.0 / sample_hz)
    times = np.unique(np.concatenate([np.round(grid, 9), np.round(time, 9)]))
    return times, np.deg2rad(np.interp(times, np.round(time, 9), angle))


def compensation(lag_deg: float = 26.0, target_deg: float = 45.0) -> list[float]:
    """Targets of the paper's sequence."""
    steps = (0.0, lag_deg, -0.75 * lag_deg, 0.25 * lag_deg, 0.0)
    return [target_deg + step for step in steps]


def refined(time: np.ndarray, base: np.ndarray, times: int) -> tuple[np.ndarray, np.ndarray]:
    """The same path with `times` samples for one; every `times`-th is an old one."""
    fine = np.interp(np.arange((len(time) - 1) * times + 1) / times, np.arange(len(time)), time)
    return fine, np.interp(fine, time, base)


def errors(one: Solution, other: Solution, every: int = 1) -> tuple[float, float]:
    """Largest difference at the sensors (degrees) and in torque (N·mm); `other` is `every` times finer."""
    angle = np.abs(one.sensor_rad - other.sensor_rad[::every]).max()
    return float(np.degrees(angle)), float(np.abs(one.torque_nm - other.torque_nm[::every]).max() * 1e3)
