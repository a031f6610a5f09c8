"""A cable is softer while it pulls little.

Law: within a twist w of the whole line, |θ_base − θ_tip| ≤ w/2, it has c times the stiffness that it has
beyond, length by length. c near 0 is lost motion spread along the line; c = 1 is none.

Source: strands that settle and lose contact: Costello, "Theory of wire rope" (1997); loops of two cables with
little preload, of which one sags: Palli, Borghesan, Melchiorri, "Modeling, identification, and control of
tendon-based actuation systems", IEEE Trans. Robotics 28 (2012).

Shows best: reversals under two loads: the lag changes more where the torque that is carried crosses zero.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import rad


@dataclass(frozen=True)
class SoftCable(Effect):
    """Smaller stiffness of the line about its rest."""

    relatives = ("loose_load", "pulley_friction", "tissue_elasticity")
    resistive = True

    twist_deg: float = parameter(
        off=0.0,
        lower=0.0,
        upper=20.0,
        typical=4.0,
        smallest=0.2,
        literature=(0.0, 10.0),
        unit="°",
    )
    stiffness_ratio: float = parameter(
        off=1.0,
        lower=0.02,
        upper=1.0,
        typical=0.3,
        smallest=0.1,
        literature=(0.05, 1.0),
        unit="1",
        shapes=True,
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Give every element its share of w, and c within it unless it has a play of its own."""
        twist_rad = np.append(rad(self.twist_deg) * np.diff(rod.position_m) / np.ptp(rod.position_m), 0.0)
        soft = np.where(rod.play_rad > 0.0, rod.slack_stiffness, self.stiffness_ratio)
        return replace(rod, play_rad=rod.play_rad + twist_rad, slack_stiffness=soft)
