"""The angle along the shaft between its sensors: what a resting rod allows, given what they read.

The shaft obeys dθ/dx = −T/(JG) and dT/dx = −q, with friction q in the tissue alone, constant over each half
of a section, and no torque past the tip. Of each q nothing is known but its size (a normal prior), and each
sensor's noise. Everything is linear, so that the estimate is a matrix times the readings, made once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.needle_model import BASE_PARAMETERS, FRICTION
from needle_rig.service.api.documents import Rig
from needle_rig.units import deg, mm, nm, per_length_n, rad

FRICTION_N = per_length_n(BASE_PARAMETERS[FRICTION].literature[1])
"""Standard deviation of q: the largest that was ever published, so that the prior says next to nothing."""
TORQUE_NOISE_NM = nm(0.0008)
HALL_NOISE_RAD = rad(0.25)
BASE_NOISE_RAD = rad(0.02)
"""Of the simulated rig (config/rig.yaml), in the order of the paper's sensors."""
TIP_TORQUE_NM = nm(0.002)
"""Friction of a tip that cuts nothing: the smallest that matters of `tip_friction`."""
PLACES = 80


@dataclass(frozen=True)
class ShaftEstimate:
    """`gain` (places, 2 + sensors) takes base angle, torque and Hall angles, in SI, to the angle at
    `position_m`; `deviation_rad` is its standard deviation there."""

    position_m: Array
    gain: Array
    deviation_rad: Array

    def as_json(self) -> dict[str, Any]:
        """For readings in degrees and N·mm, as the daemon tells them."""
        units = np.r_[rad(1.0), nm(1.0), np.full(self.gain.shape[1] - 2, rad(1.0))]
        return {
            "places_mm": [round(float(p), 2) for p in mm(self.position_m)],
            "gain_deg": np.round(deg(self.gain * units), 6).tolist(),
            "deviation_deg": [round(float(d), 4) for d in deg(self.deviation_rad)],
        }


def shaft_estimate(rig: Rig) -> ShaftEstimate:
    """The estimate for a rig as its daemon tells it."""
    length_m, rigidity_nm2 = rig["needle_length_mm"] / 1e3, rig["torsional_rigidity_nmm2"] * 1e-6
    halves = [
        half
        for a, b in rig["tissue_sections_mm"]
        for half in ((a / 1e3, (a + b) / 2e3), ((a + b) / 2e3, b / 1e3))
    ]
    position_m = np.linspace(0.0, length_m, PLACES)
    sensors_m = np.array(rig["hall_positions_mm"]) / 1e3

    def angle(at_m: Array) -> Array:
        """Rows of the angle at places, by the unknowns: base angle, base torque, each q."""
        columns = [np.ones_like(at_m), -at_m / rigidity_nm2]
        columns += [_twist(at_m, a, b) / rigidity_nm2 for a, b in halves]
        return np.stack(columns, axis=1)

    count = len(halves)
    rows = np.vstack(
        [
            np.eye(2, 2 + count),  # base angle, torque
            angle(sensors_m),
            np.r_[0.0, 1.0, [-(b - a) for a, b in halves]][None, :],  # torque past the tip
        ]
    )
    noise = np.r_[BASE_NOISE_RAD, TORQUE_NOISE_NM, np.full(len(sensors_m), HALL_NOISE_RAD), TIP_TORQUE_NM]
    prior = np.r_[0.0, 0.0, np.full(count, FRICTION_N**-2.0)]
    # the unknowns differ by powers of ten: solve for them in units of their own size
    size = np.r_[1.0, nm(1.0), np.full(count, FRICTION_N)]
    scaled = rows * size / noise[:, None]
    precision = scaled.T @ scaled + np.diag(prior * size**2)
    at = angle(position_m) * size
    covariance = np.linalg.inv(precision)
    gain = at @ covariance @ (scaled / noise[:, None]).T
    deviation = np.sqrt(np.einsum("ij,jk,ik->i", at, covariance, at))
    return ShaftEstimate(position_m, gain[:, :-1], deviation)


def _twist(at_m: Array, start_m: float, end_m: float) -> Array:
    """∫∫ of a q of 1 over (start_m, end_m), from the base to each place, m²."""
    inside = np.clip(at_m, start_m, end_m) - start_m
    return 0.5 * inside**2 + (end_m - start_m) * np.maximum(at_m - end_m, 0.0)
