"""The base encoder's disc sits beside the axis.

Law: θ_base = θ_e − s sin θ_e − c (cos θ_e − 1), θ_e the encoder's angle: its error once a turn, zero where
it reads zero.

Source: eccentricity over radius of the scale: 0.1 mm on 15 mm are 0.38° (Synapticon, Circulo 7
documentation 4.19); Sanchez-Brea, Morlanes, "Metrological errors in optical encoders", Measurement Science
and Technology 19 (2008).

Shows best: turns beyond 90°: all sensors differ from the base by the same angle, which depends on where the
base stands and not on how it got there.
"""

from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.units import rad


@dataclass(frozen=True)
class EncoderEccentricity(Effect):
    """Once-a-turn error of the base encoder."""

    relatives = ("hall_eccentricity", "hall_gain", "chuck_backlash", "chuck_compliance")
    stage = -1

    sine_deg: float = parameter(
        off=0.0,
        lower=-20.0,
        upper=20.0,
        typical=1.5,
        smallest=0.6,
        literature=(-3.0, 3.0),
        unit="°",
    )
    cosine_deg: float = parameter(
        off=0.0,
        lower=-20.0,
        upper=20.0,
        typical=1.5,
        smallest=0.8,
        literature=(-3.0, 3.0),
        unit="°",
    )

    def drive(self, trial: Trial) -> Array:
        """The true path of the base (samples,) in rad."""
        shown_rad = trial.base_angle_rad
        error_rad = rad(self.sine_deg) * np.sin(shown_rad) + rad(self.cosine_deg) * (np.cos(shown_rad) - 1.0)
        return shown_rad - error_rad
