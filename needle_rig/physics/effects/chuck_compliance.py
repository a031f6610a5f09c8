"""Chuck, coupling and torque cell twist under load.

Law: θ_held = θ_base − τ_base/K.

Source: the rival to tissue elasticity for the 12° of Reed, BioRob 2008: K = 0.256 N·mm/rad with a friction of
0.054 N·mm per 100 mm gives 26° → 12° as well, and 0° with the further 12° turn where 3° was measured.

Shows best: every sensor moves together in proportion to the torque; deep sensors rest during the third
motion of the sequence, where elastic tissue lets them follow.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import nm


@dataclass(frozen=True)
class ChuckCompliance(Effect):
    """Series spring between the turned base and the needle."""

    part = "chuck"
    relatives = ("tissue_elasticity", "torque_gain", "chuck_backlash", "guide_friction")
    resistive = True

    stiffness_nmm_per_rad: float = parameter(
        off=float("inf"),
        lower=0.02,
        upper=1000.0,
        typical=0.5,
        smallest=15.0,
        literature=(0.2, 50.0),
        unit="N·mm/rad",
        scale="reciprocal",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add 1/K to the compliance between base and needle."""
        added = 1.0 / nm(self.stiffness_nmm_per_rad)
        return replace(rod, base_compliance_rad_per_nm=rod.base_compliance_rad_per_nm + added)
