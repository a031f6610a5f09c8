"""How one trial's friction differs from that of its series: the random effect of simulations and fits.

One factor acts on every slip limit, in tissue and lumped. The practice dataset with friction at the tip, made
by another code, is met to its noise that way; with the factor on the tissue alone it is not.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod


@dataclass(frozen=True)
class FrictionOfTrial(Effect):
    """Factor on every slip limit, in tissue and lumped."""

    stage = 1000

    factor: float = parameter(
        off=1.0, lower=0.0, upper=10.0, typical=1.02, smallest=1.01, literature=(0.5, 2.0), unit="1"
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:  # noqa: ARG002 see Effect
        """Multiply both slip limits of all nodes."""
        return dataclasses.replace(
            rod, slip_plus_nm=rod.slip_plus_nm * self.factor, slip_minus_nm=rod.slip_minus_nm * self.factor
        )
