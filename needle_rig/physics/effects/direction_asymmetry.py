"""Friction differs between the two directions of turning.

Law: υ₊ = υ(1 + a) for counter-clockwise slip, υ₋ = υ(1 − a) for clockwise slip.

Source: direction-dependent Coulomb friction: Armstrong-Hélouvry, Dupont, Canudas de Wit, "A survey of models,
analysis tools and compensation methods for the control of machines with friction", Automatica 30 (1994).

Shows best: the same trial with the opposite sign: lag and torque after the first turn differ in size.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod


@dataclass(frozen=True)
class DirectionAsymmetry(Effect):
    """Unequal slip limits in the tissue."""

    relatives = ("torque_bias", "bending_torque")
    resistive = True

    asymmetry: float = parameter(
        off=0.0,
        lower=-0.95,
        upper=0.95,
        typical=0.15,
        smallest=0.02,
        literature=(-0.4, 0.4),
        unit="1",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Scale the slip limits of the tissue nodes by 1 ± a."""
        share = np.where(rod.tissue_length_m > 0, self.asymmetry, 0.0)
        return replace(
            rod,
            slip_plus_nm=rod.slip_plus_nm * (1.0 + share),
            slip_minus_nm=rod.slip_minus_nm * (1.0 - share),
        )
