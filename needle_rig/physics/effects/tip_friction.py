"""Friction that acts at the tip alone, as of a bevel that cuts.

Law: |τ_tip| ≤ T, equal to T against the motion while the tip turns.

Source: Abolhassani, Patel, Ayazi, "Minimization of needle deflection in robot-assisted percutaneous therapy",
Int. J. Medical Robotics and Computer Assisted Surgery 3 (2007), who lump all friction at the tip.

Shows best: settle after a long turn in one direction: every interval between sensors carries the same
extra twist, also the one nearest the tip.
"""

from dataclasses import dataclass

from needle_rig.physics.effect import Effect, Trial, parameter, with_lumped_friction
from needle_rig.physics.rod import Rod
from needle_rig.units import nm


@dataclass(frozen=True)
class TipFriction(Effect):
    """Lumped Coulomb friction at the tip's node."""

    part = "end"
    relatives = ("layered_friction", "platform_friction")
    resistive = True

    torque_nmm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=1.0,
        typical=0.03,
        smallest=0.0014,
        literature=(0.0, 0.1),
        unit="N·mm",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add T to both slip limits of the tip."""
        return with_lumped_friction(rod, rod.tip, nm(self.torque_nmm))
