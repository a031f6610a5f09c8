"""The longer the needle rests, the firmer the tissue holds it.

Law: υ = υ_k (1 + β log₁₀(1 + a/t₀)), with the age a of the contact: da/dt = 1 − a|ω|/s_w; it grows at rest
and is worn off by slip over the length s_w.

Source: Dieterich, "Time-dependent friction and the mechanics of stick-slip", Pure and Applied Geophysics 116
(1978); ageing law as in Ruina, J. Geophysical Research 88 (1983).

Shows best: the same restart after 0.5 s and after 20 s of rest: the torque peak grows with the dwell.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod


@dataclass(frozen=True)
class StictionAgeing(Effect):
    """Growth of the tissue's slip limit with rest time; worn off over the rod's weakening slip."""

    relatives = ("stribeck", "tissue_viscoelasticity")
    resistive = True

    growth_per_decade: float = parameter(
        off=0.0,
        lower=0.0,
        upper=3.0,
        typical=0.2,
        smallest=0.04,
        literature=(0.0, 0.5),
        unit="1/decade",
    )
    rest_time_s: float = parameter(
        off=0.0,
        lower=0.01,
        upper=1000.0,
        typical=1.0,
        smallest=0.2,
        literature=(0.1, 30.0),
        unit="s",
        scale="log",
        shapes=True,
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add the growth at every tissue node."""
        added = np.where(rod.tissue_length_m > 0, self.growth_per_decade, 0.0)
        return replace(rod, ageing_per_decade=rod.ageing_per_decade + added, ageing_time_s=self.rest_time_s)
