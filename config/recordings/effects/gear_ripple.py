"""Teeth or windings between the tip and its encoder carry it unevenly.

Law: m = θ + s sin nθ + c cos nθ, n times a turn.

Source: transmission error of gears repeats with their teeth: e.g. Smith, "Gear noise and vibration" (2003).

Shows best: a slow turn: the angle left over waves, alike in both directions and under every load.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Reading, parameter
from needle_rig.units import rad


@dataclass(frozen=True)
class GearRipple(Effect):
    """Error of the last sensor that repeats several times a turn."""

    relatives = ("hall_harmonics", "hall_eccentricity")

    sine_deg: float = parameter(
        off=0.0,
        lower=-2.0,
        upper=2.0,
        typical=0.1,
        smallest=0.05,
        literature=(-0.5, 0.5),
        unit="°",
    )
    cosine_deg: float = parameter(
        off=0.0,
        lower=-2.0,
        upper=2.0,
        typical=0.1,
        smallest=0.05,
        literature=(-0.5, 0.5),
        unit="°",
    )
    per_turn: float = parameter(
        off=0.0,
        lower=6.0,
        upper=40.0,
        typical=12.0,
        smallest=1.0,
        literature=(6.0, 40.0),
        unit="1",
        shapes=True,
    )

    def observe(self, reading: Reading) -> Reading:
        """Add the ripple to the column of the last sensor."""
        hall_rad = reading.hall_rad.copy()
        phase = self.per_turn * hall_rad[:, -1]
        hall_rad[:, -1] += rad(self.sine_deg) * np.sin(phase) + rad(self.cosine_deg) * np.cos(phase)
        return replace(reading, hall_rad=hall_rad)
