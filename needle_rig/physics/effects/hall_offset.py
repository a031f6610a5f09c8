"""A Hall sensor's zero is turned against the base encoder's.

Law: m_i = θ_i + o_i for sensor i.

Source: mounting angle of the magnet on the needle; Hall angle sensors as in Reed, BioRob 2008.

Shows best: the sensors' readings at rest before the first motion, where every true angle is zero.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, PerItem, Reading, parameter
from needle_rig.units import rad


@dataclass(frozen=True)
class HallOffset(Effect):
    """Constant offset of each Hall angle."""

    relatives = ("hall_eccentricity", "hall_gain", "chuck_backlash")

    offset_deg: PerItem = parameter(
        off=0.0,
        lower=-180.0,
        upper=180.0,
        typical=2.0,
        smallest=0.5,
        literature=(-10.0, 10.0),
        unit="°",
        per="sensor",
    )

    def observe(self, reading: Reading) -> Reading:
        """Add each sensor's offset to its column."""
        offset_rad = rad(self.each("offset_deg", reading.hall_rad.shape[1]))
        return replace(reading, hall_rad=reading.hall_rad + offset_rad)
