"""The phantom turns in its mount.

Law: ψ = τ/K: everything that touches the needle turns as one body by ψ on a spring K, and the needle slips
against it. Seen from the phantom, the base stays behind by ψ; every true angle is larger by ψ than seen
from there. Guide and sensor platforms are taken to stand on the same mount, as phantoms on one carrier do.

Source: a rigid body on a torsion spring, loaded with the torque that the needle's base takes up. The size
is an estimate: a gel cube of 50 mm (shear modulus 5 kPa) glued at one end gives 90 N·mm/rad, a loose one
less.

Shows best: a small reversal: deep sensors, which slip has not reached yet, turn at once and all alike by τ/K.
In elastic tissue they turn by different angles, in rigid tissue not at all.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import nm


@dataclass(frozen=True)
class MountCompliance(Effect):
    """Spring between the phantom as a whole and the bench."""

    part = "needle"
    relatives = ("tissue_elasticity", "chuck_compliance", "tip_friction", "guide_friction")
    resistive = True

    stiffness_nmm_per_rad: float = parameter(
        off=float("inf"),
        lower=0.02,
        upper=1000.0,
        typical=2.0,
        smallest=20.0,
        literature=(0.5, 200.0),
        unit="N·mm/rad",
        scale="reciprocal",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add 1/K to the compliance of the mount."""
        added = 1.0 / nm(self.stiffness_nmm_per_rad)
        return replace(rod, mount_compliance_rad_per_nm=rod.mount_compliance_rad_per_nm + added)
