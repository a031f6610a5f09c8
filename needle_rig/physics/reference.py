"""The paper's finite-element scheme, literally: disks, Karnopp friction, explicit steps. Slow on purpose.

K. B. Reed, "Compensating for Torsion Windup in Steerable Needles", BioRob 2008. It shares no code with the
solver, so that each can be held against the other. Karnopp's law: inside a velocity band a disk sticks while
the torque on it is below the static limit; outside the band damping resists, and a kinetic limit where one
is given (the paper gives none).

Without inertia a disk's velocity is (torque − kinetic limit)/damping, which needs damping and is stable up
to damping · h²/(2 JG) (5.6e-5 s at the paper's values); free spans are springs. With inertia every disk of
the whole needle moves; damping is taken at the end of the step, the rest explicitly: stable up to h √(ρ/G),
2.4e-7 s.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.physics.kernel._cache import kept
from needle_rig.physics.rod import Layout


@dataclass(frozen=True)
class KarnoppRod:
    """A needle of disks in tissue with Karnopp friction; per-length values in N·m (·s/rad) per metre."""

    layout: Layout
    torsional_rigidity_nm2: float
    static_limit_n: float
    kinetic_limit_n: float
    damping_ns: float
    velocity_band_rad_s: float = 1e-3
    """The paper does not state it, and with no kinetic limit the end state depends on it."""
    inertia_kgm: float = 0.0
    """Polar moment of inertia per length, ρ · πd⁴/32; 0 leaves inertia out."""
    disk_m: float = 0.5e-3


@dataclass(frozen=True, eq=False)
class ReferenceSolution:
    """Shapes: torque and tip (samples,), sensors (samples, sensors)."""

    time_s: Array
    torque_nm: Array
    sensor_rad: Array
    tip_rad: Array


def paper_literal(layout: Layout, velocity_band_rad_s: float = 1e-3) -> KarnoppRod:
    """The paper's values: static 0.45 N·mm and damping 2.8 N·mm·s per 100 mm, JG 62.56 N·mm²."""
    return KarnoppRod(layout, 62.56e-6, 0.45e-2, 0.0, 2.8e-2, velocity_band_rad_s)


def largest_stable_step_s(rod: KarnoppRod) -> float:
    """Longest explicit step: elastic waves with inertia, diffusion of slip without."""
    if rod.inertia_kgm > 0:
        return rod.disk_m * math.sqrt(rod.inertia_kgm / rod.torsional_rigidity_nm2)
    return 0.5 * rod.damping_ns * rod.disk_m**2 / rod.torsional_rigidity_nm2


def simulate(
    rod: KarnoppRod, time_s: Array, base_angle_rad: Array, step_s: float = 1e-6
) -> ReferenceSolution:
    """Turn the base along the line through (time_s, base_angle_rad), shapes (samples,), from rest at 0.

    Raises BadInput for a step that cannot be stable or for no damping without inertia.
    """
    limit = largest_stable_step_s(rod)
    if not 0 < step_s <= limit * (1 + 1e-9):
        raise BadInput(
            f"explicit steps of {step_s:g} s are unstable for this rod; at most {limit:.3g} s"
            " (which is 0 without damping or inertia)"
        )
    time = np.ascontiguousarray(time_s, dtype=np.float64)
    base = np.ascontiguousarray(base_angle_rad, dtype=np.float64)
    position, tissue = _disks(rod)
    distance = np.diff(position, prepend=0.0)
    left = rod.torsional_rigidity_nm2 / distance
    right = np.append(left[1:], 0.0)
    inertia = np.full(len(position), rod.inertia_kgm * rod.disk_m)
    disks, torque = _explicit(
        left,
        right,
        rod.static_limit_n * tissue,
        rod.kinetic_limit_n * tissue,
        rod.damping_ns * tissue,
        inertia,
        rod.velocity_band_rad_s,
        time,
        base,
        step_s,
    )
    known = np.concatenate([base[:, None], disks], axis=1)
    places = np.append(0.0, position)
    sensors = np.array(rod.layout.sensor_positions_m)
    # the twist of a span between disks is linear
    readings = np.array([np.interp(sensors, places, sample) for sample in known]).reshape(len(time), -1)
    return ReferenceSolution(time, torque, readings, disks[:, -1].copy())


def _disks(rod: KarnoppRod) -> tuple[Array, Array]:
    """Places of the disks and the length of tissue on each."""
    ends = [0.0]
    for section in rod.layout.tissue_sections_m:
        ends += section
    ends.append(rod.layout.needle_length_m)
    places: list[npt.NDArray[Any]] = []
    tissue: list[npt.NDArray[Any]] = []
    for number, (start, end) in enumerate(itertools.pairwise(ends)):
        in_tissue = number % 2 == 1
        count = round((end - start) / rod.disk_m)
        if count == 0 or not (in_tissue or rod.inertia_kgm > 0):
            continue
        length = (end - start) / count
        places.append(start + length * (np.arange(count) + 0.5))
        tissue.append(np.full(count, length if in_tissue else 0.0))
    return np.concatenate(places), np.concatenate(tissue)


@kept(nogil=True, fastmath=True)
def _explicit(left, right, static, kinetic, damping, inertia, band, times, base, step):  # type: ignore[no-untyped-def]
    """Angles of the disks (samples, disks) and the base torque (samples,)."""
    n = left.size
    angles = np.zeros(n + 2)  # the base in front, a copy of the tip behind
    before, here, behind = angles[:n], angles[1 : n + 1], angles[2:]
    velocity = np.zeros(n)
    out = np.zeros((times.size, n))
    torque = np.zeros(times.size)
    has_inertia = inertia[0] > 0.0
    angles[:] = base[0]
    out[0] = here
    for row in range(1, times.size):
        steps = math.ceil((times[row] - times[row - 1]) / step - 1e-9)
        dt = (times[row] - times[row - 1]) / steps
        turn = (base[row] - base[row - 1]) / steps
        for k in range(steps):
            angles[0] = base[row - 1] + (k + 1) * turn
            angles[n + 1] = angles[n]
            for i in range(n):
                load = left[i] * (before[i] - here[i]) + right[i] * (behind[i] - here[i])
                speed = velocity[i]
                sticks = abs(speed) < band and abs(load) <= static[i]
                if has_inertia:
                    way = speed if abs(speed) >= band else load
                    resist = kinetic[i] if way > 0.0 else -kinetic[i]
                    moved = (speed + dt * (load - resist) / inertia[i]) / (1.0 + dt * damping[i] / inertia[i])
                    stopped = moved * speed < 0.0 and abs(load) <= static[i]
                    velocity[i] = 0.0 if (sticks and static[i] > 0.0) or stopped else moved
                else:
                    driven = max(abs(load) - kinetic[i], 0.0) / damping[i]
                    velocity[i] = 0.0 if sticks else (driven if load > 0.0 else -driven)
            for i in range(n):
                here[i] += dt * velocity[i]
        out[row] = here
        torque[row] = left[0] * (angles[0] - here[0])
    return out, torque
