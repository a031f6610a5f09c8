"""The needle rubs in the bearings of the sensor platforms.

Law: |τ_i| ≤ T_i at sensor i, equal to T_i against the motion while the needle turns there.

Source: an estimate of 0.002–0.006 N·mm for a 0.39 mm wire in a plastic bushing (normal force times radius);
platforms as in Reed, BioRob 2008.

Shows best: settle after a long turn: the twist steps up at every platform, and also with no tissue around.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, PerItem, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import nm


@dataclass(frozen=True)
class PlatformFriction(Effect):
    """Lumped Coulomb friction at the node of each sensor."""

    part = "needle"
    relatives = ("layered_friction", "tip_friction")
    resistive = True

    torque_nmm: PerItem = parameter(
        off=0.0,
        lower=0.0,
        upper=0.2,
        typical=0.004,
        smallest=0.0005,
        literature=(0.0, 0.01),
        unit="N·mm",
        per="sensor",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add T_i to both slip limits of each sensor's node."""
        added = np.zeros_like(rod.position_m)
        np.add.at(added, rod.sensors, nm(self.each("torque_nmm", rod.sensors.size)))
        return replace(rod, slip_plus_nm=rod.slip_plus_nm + added, slip_minus_nm=rod.slip_minus_nm + added)
