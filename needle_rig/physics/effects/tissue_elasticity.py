r"""Tissue gives way elastically before it slips.

Law: τ_t = k (θ − p) per length, slipping (p moves) where |τ_t| would exceed the friction υ; k → ∞ is
rigid tissue. Elastic decay length along the needle ℓ = √(JG/k).

Source: Dupont, Hayward, Armstrong, Altpeter, "Single state elastoplastic friction models", IEEE Trans.
Automatic Control 47 (2002); needed to meet the 12° of Reed, BioRob 2008, figure 6 (there not modelled).

Shows best: reverse the base by less than the lag and watch the deep sensors: they follow an elastic tissue
and rest in a rigid one. The lag left after the whole sequence is its second sign.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import per_length_n


@dataclass(frozen=True)
class TissueElasticity(Effect):
    """Spring between needle and tissue, in series with whatever gives way already."""

    part = "needle"
    relatives = ("tissue_viscoelasticity", "chuck_compliance", "torque_gain")
    resistive = True

    stiffness_nmm_per_rad_per_100mm: float = parameter(
        off=float("inf"),
        lower=0.02,
        upper=200.0,
        typical=0.35,
        smallest=20.0,
        literature=(0.1, 2.0),
        unit="N·mm/rad per 100 mm",
        scale="reciprocal",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add 1/(k·length) to the pre-sliding compliance of every tissue node."""
        added = np.zeros_like(rod.position_m)
        tissue = rod.tissue_length_m > 0
        stiffness_n = per_length_n(self.stiffness_nmm_per_rad_per_100mm)
        added[tissue] = 1.0 / (stiffness_n * rod.tissue_length_m[tissue])
        return replace(rod, compliance_rad_per_nm=rod.compliance_rad_per_nm + added)
