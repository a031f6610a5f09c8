"""The cable is bent around a pulley in one place and rubs there.

Law: |τ| ≤ T + c |τ_line| in one place of the line, τ_line the mean of what it carries before and behind:
T comes from the preload, c = 2 tanh(μφ/2) is that of a cable wrapped around by φ (Euler).

Source: Kaneko, Yamashita, Tanie, "Basic considerations on transmission characteristics for tendon drive
robots", ICAR 1991; wrist pulleys of instruments: Anooshahpour, Polushin, Patel, "Quasi-static modeling of the
da Vinci instrument", IROS 2014.

Shows best: a reversal: first the line up to the pulley alone twists, stiffly, then all of it.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import nm


@dataclass(frozen=True)
class PulleyFriction(Effect):
    """Lumped friction somewhere along the line, in part growing with the pull."""

    relatives = ("capstan_friction", "loose_load", "tip_friction", "tissue_elasticity")
    resistive = True

    torque_nmm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=1.0,
        typical=0.01,
        smallest=0.0014,
        literature=(0.0, 0.1),
        unit="N·mm",
    )
    per_torque: float = parameter(
        off=0.0,
        lower=0.0,
        upper=2.0,
        typical=0.2,
        smallest=0.02,
        literature=(0.0, 0.6),
        unit="1",
    )
    place: float = parameter(
        off=0.0,
        lower=0.05,
        upper=0.95,
        typical=0.75,
        smallest=0.05,
        literature=(0.05, 0.95),
        unit="1",
        shapes=True,
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Give T and c to the two nodes next to the place, by nearness, so that the place moves smoothly."""
        at_m = self.place * rod.position_m[-1]
        after = int(np.clip(np.searchsorted(rod.position_m, at_m), 1, rod.tip))
        share = (at_m - rod.position_m[after - 1]) / (rod.position_m[after] - rod.position_m[after - 1])
        here = np.zeros_like(rod.position_m)
        here[after - 1 : after + 1] = 1.0 - share, share
        return replace(
            rod,
            slip_plus_nm=rod.slip_plus_nm + nm(self.torque_nmm) * here,
            slip_minus_nm=rod.slip_minus_nm + nm(self.torque_nmm) * here,
            slip_per_torque=rod.slip_per_torque + self.per_torque * here,
        )
