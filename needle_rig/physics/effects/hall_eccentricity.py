"""A Hall sensor's magnet sits beside the needle's axis.

Law: m_i = θ_i + s_i sin θ_i + c_i cos θ_i, that is θ_i + h sin(θ_i − φ) with h = √(s² + c²), tan φ = −c/s.

Source: first harmonic of eccentric angle encoders, e.g. Sanchez-Brea, Morlanes, "Metrological errors in
optical encoders", Measurement Science and Technology 19 (2008).

Shows best: a full turn, slowly: the error of one sensor varies once a turn with that sensor's own angle,
alike in both directions.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, PerItem, Reading, parameter
from needle_rig.units import rad


@dataclass(frozen=True)
class HallEccentricity(Effect):
    """Once-a-turn error of each Hall angle."""

    relatives = ("hall_gain", "hall_offset", "bending_torque")

    sine_deg: PerItem = parameter(
        off=0.0,
        lower=-30.0,
        upper=30.0,
        typical=3.0,
        smallest=0.65,
        literature=(-8.0, 8.0),
        unit="°",
        per="sensor",
    )
    cosine_deg: PerItem = parameter(
        off=0.0,
        lower=-30.0,
        upper=30.0,
        typical=2.0,
        smallest=0.5,
        literature=(-8.0, 8.0),
        unit="°",
        per="sensor",
    )

    def observe(self, reading: Reading) -> Reading:
        """Add each sensor's first harmonic to its column."""
        sensors = reading.hall_rad.shape[1]
        sine = rad(self.each("sine_deg", sensors)) * np.sin(reading.hall_rad)
        cosine = rad(self.each("cosine_deg", sensors)) * np.cos(reading.hall_rad)
        return replace(reading, hall_rad=reading.hall_rad + sine + cosine)
