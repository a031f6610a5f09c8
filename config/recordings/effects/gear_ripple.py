"""Teeth or windings between the tip and its encoder carry it unevenly.

Law: m = θ + s sin nθ + c cos nθ + s₂ sin n₂θ + c₂ cos n₂θ, n and n₂ times a turn: two stages, or one whose
teeth or windings do not repeat as a sine.

Source: transmission error of gears repeats with their teeth: e.g. Smith, "Gear noise and vibration" (2003).

Shows best: a slow turn: the angle left over waves, alike in both directions and under every load.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Reading, parameter
from needle_rig.units import rad


def _amplitude_deg() -> float:
    return parameter(
        off=0.0, lower=-2.0, upper=2.0, typical=0.1, smallest=0.05, literature=(-0.5, 0.5), unit="°"
    )


def _per_turn(lower: float, upper: float, typical: float) -> float:
    return parameter(
        off=0.0,
        lower=lower,
        upper=upper,
        typical=typical,
        smallest=1.0,
        literature=(lower, upper),
        unit="1",
        shapes=True,
    )


@dataclass(frozen=True)
class GearRipple(Effect):
    """Error of the last sensor that repeats several times a turn."""

    relatives = ("hall_harmonics", "hall_eccentricity")

    sine_deg: float = _amplitude_deg()
    cosine_deg: float = _amplitude_deg()
    per_turn: float = _per_turn(6.0, 20.0, 12.0)
    second_sine_deg: float = _amplitude_deg()
    second_cosine_deg: float = _amplitude_deg()
    second_per_turn: float = _per_turn(20.0, 60.0, 24.0)

    def observe(self, reading: Reading) -> Reading:
        """Add the ripple to the column of the last sensor."""
        hall_rad = reading.hall_rad.copy()
        angle_rad = hall_rad[:, -1].copy()
        for sine_deg, cosine_deg, per_turn in (
            (self.sine_deg, self.cosine_deg, self.per_turn),
            (self.second_sine_deg, self.second_cosine_deg, self.second_per_turn),
        ):
            phase = per_turn * angle_rad
            hall_rad[:, -1] += rad(sine_deg) * np.sin(phase) + rad(cosine_deg) * np.cos(phase)
        return replace(reading, hall_rad=hall_rad)
