"""A Hall sensor also sees its neighbours' magnets.

Law: m_i = arg(e^{iθ_i} + k Σ_n e^{iθ_n}) over the sensors n next to i along the needle: the fields, or the
signals in common wires, add up. Small differences of the angles are drawn together: m_i ≈ θ_i + k Σ_n (θ_n
− θ_i).

Source: superposition of fields; the angle is the arctangent of their components. The size is an estimate: a
magnet's field falls with the cube of the distance, so that k of a few per cent takes neighbours at three
times the distance of a sensor from its own magnet, or wires and multiplexers that they share.

Shows best: hold the needle at one sensor and turn the next one's magnet. Within a series: a sensor's error
goes with the twist between it and its neighbours.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Reading, parameter


@dataclass(frozen=True)
class HallCrosstalk(Effect):
    """Share of each neighbour's field in what a Hall sensor sees."""

    part = "needle"
    relatives = ("hall_gain", "hall_harmonics", "platform_friction", "layered_friction")
    stage = -2

    share: float = parameter(
        off=0.0,
        lower=-0.45,
        upper=0.45,
        typical=0.2,
        smallest=0.13,
        literature=(-0.3, 0.3),
        unit="1",
    )

    def observe(self, reading: Reading) -> Reading:
        """Turn each sensor's field by what its neighbours add to it."""
        along, across = np.ones_like(reading.hall_rad), np.zeros_like(reading.hall_rad)
        ahead_rad = np.diff(reading.hall_rad, axis=1)
        for column, difference_rad in ((slice(None, -1), ahead_rad), (slice(1, None), -ahead_rad)):
            along[:, column] += self.share * np.cos(difference_rad)
            across[:, column] += self.share * np.sin(difference_rad)
        return replace(reading, hall_rad=reading.hall_rad + np.arctan2(across, along))
