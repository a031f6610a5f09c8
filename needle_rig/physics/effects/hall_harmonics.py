"""A Hall sensor's error varies more than once a turn.

Law: m_i = θ_i + s₂ sin 2θ_i + c₂ cos 2θ_i + s₄ sin 4θ_i + c₄ cos 4θ_i, with coefficients for each sensor.

Source: angle from two channels by the arctangent: unequal amplitudes give sin 2θ (half the relative
mismatch), channels that are not at right angles cos 2θ, third harmonics in the channels the fourth, e.g.
Kuntz, Dauth, Gerlach, Ott, Fella, arXiv 2205.08472; Texas Instruments, SLYA085. Plausible is what 10 % of
mismatch (2.9°), 6° from the right angle (3°) and 2.5 % of third harmonic (1.5°) give.

Shows best: a full turn, slowly: the error of one sensor varies twice or four times a turn with that
sensor's own angle, alike in both directions. Within a quarter turn it looks like a gain or an eccentric
magnet.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, PerItem, Reading, parameter
from needle_rig.units import rad


@dataclass(frozen=True)
class HallHarmonics(Effect):
    """Errors of each Hall angle that vary twice and four times a turn."""

    relatives = ("hall_eccentricity", "hall_gain", "hall_offset", "hall_crosstalk")

    second_sine_deg: PerItem = parameter(
        off=0.0,
        lower=-15.0,
        upper=15.0,
        typical=2.0,
        smallest=0.5,
        literature=(-3.0, 3.0),
        unit="°",
        per="sensor",
    )
    second_cosine_deg: PerItem = parameter(
        off=0.0,
        lower=-15.0,
        upper=15.0,
        typical=1.5,
        smallest=0.5,
        literature=(-3.0, 3.0),
        unit="°",
        per="sensor",
    )
    fourth_sine_deg: PerItem = parameter(
        off=0.0,
        lower=-10.0,
        upper=10.0,
        typical=1.0,
        smallest=0.5,
        literature=(-1.5, 1.5),
        unit="°",
        per="sensor",
    )
    fourth_cosine_deg: PerItem = parameter(
        off=0.0,
        lower=-10.0,
        upper=10.0,
        typical=1.0,
        smallest=0.5,
        literature=(-1.5, 1.5),
        unit="°",
        per="sensor",
    )

    def observe(self, reading: Reading) -> Reading:
        """Add each sensor's harmonics to its column."""
        angle_rad = reading.hall_rad
        error_rad = np.zeros_like(angle_rad)
        for order, name in ((2, "second"), (4, "fourth")):
            sine, cosine = (
                rad(self.each(f"{name}_{part}_deg", angle_rad.shape[1])) for part in ("sine", "cosine")
            )
            error_rad += sine * np.sin(order * angle_rad) + cosine * np.cos(order * angle_rad)
        return replace(reading, hall_rad=angle_rad + error_rad)
