"""The needle rubs in the guide through which it enters the tissue.

Law: |τ_entry| ≤ T, equal to T against the motion while the needle turns there.

Source: telescoping guides against buckling, Webster, Memisevic, Okamura, "Design considerations for robotic
needle steering", ICRA 2005; the size is an estimate (normal force times radius).

Shows best: settle after a long turn: extra twist of the free length between base and entry, and none beyond.
Friction in the chuck's own bearing looks the same to the torque cell; a sensor just before the entry tells.
"""

from dataclasses import dataclass

from needle_rig.physics.effect import Effect, Trial, parameter, with_lumped_friction
from needle_rig.physics.rod import Rod
from needle_rig.units import nm


@dataclass(frozen=True)
class GuideFriction(Effect):
    """Lumped Coulomb friction at the entry's node."""

    part = "needle"
    relatives = ("insertion_depth", "chuck_compliance", "torque_gain")
    resistive = True

    torque_nmm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=1.0,
        typical=0.02,
        smallest=0.002,
        literature=(0.0, 0.05),
        unit="N·mm",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add T to both slip limits of the entry's node."""
        return with_lumped_friction(rod, rod.entry, nm(self.torque_nmm))
