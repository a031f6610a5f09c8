"""Friction falls as the needle polishes its channel.

Law: υ = υ₀ e^{−c n} for all of a trial, with n the turns that the base made in the trials before it (sum of
|motion| / 360°). Negative c is friction that grows, as of drying tissue.

Source: running-in of sliding contacts: Blau, "On the nature of running-in", Tribology Int. 38 (2005).
Not told apart from a slow drift of the tissue's temperature by one series; a pause without motion tells.

Shows best: repeat one command through a series: the torque after the first motion drifts with the order of
the trials, the final angles do not.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod


@dataclass(frozen=True)
class FrictionWear(Effect):
    """Friction of the tissue that falls with the travel before the trial."""

    relatives = ("torque_drift", "torque_gain")
    resistive = True

    loss_per_turn: float = parameter(
        off=0.0,
        lower=-0.5,
        upper=2.0,
        typical=0.06,
        smallest=0.006,
        literature=(0.0, 0.3),
        unit="1/turn",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Scale both slip limits of the tissue nodes."""
        left = math.exp(-self.loss_per_turn * trial.travel_before_rad / math.tau)
        factor = np.where(rod.tissue_length_m > 0, left, 1.0)
        return replace(rod, slip_plus_nm=rod.slip_plus_nm * factor, slip_minus_nm=rod.slip_minus_nm * factor)
