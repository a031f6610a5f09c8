"""A Hall sensor reads a multiple of the angle.

Law: m_i = (1 + g_i) θ_i for sensor i.

Source: amplitude and phase errors of the two fields from which the angle is calculated: Hall
sensors are analogue and ratiometric.

Shows best: compare two settled states far apart in angle, reached in the same direction.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, PerItem, Reading, parameter


@dataclass(frozen=True)
class HallGain(Effect):
    """Relative error of the scale of each Hall angle."""

    relatives = ("hall_eccentricity", "hall_offset")
    stage = -1

    gain_error: PerItem = parameter(
        off=0.0,
        lower=-0.5,
        upper=0.5,
        typical=0.05,
        smallest=0.01,
        literature=(-0.1, 0.1),
        unit="1",
        per="sensor",
    )

    def observe(self, reading: Reading) -> Reading:
        """Stretch each sensor's column."""
        gain = 1.0 + self.each("gain_error", reading.hall_rad.shape[1])
        return replace(reading, hall_rad=reading.hall_rad * gain)
