"""A cable rubs on what it is bent around the harder it pulls.

Law: |τ_t| ≤ υ + μ |T| per length, with the torque T that the shaft or cable carries there; where all of it
slips, T falls as e^(−μ x) beside what υ takes (Euler's belt formula).

Source: Euler and Eytelwein; of cables in surgical instruments: Kaneko, Yamashita, Tanie, "Basic
considerations on transmission characteristics for tendon drive robots", ICAR 1991; Agrawal, Peine, Yao,
"Modeling of transmission characteristics across a cable-conduit system", IEEE Trans. Robotics 26 (2010).

Shows best: the same turn with two loads at the tip: the width of the loop grows with the load.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod


@dataclass(frozen=True)
class CapstanFriction(Effect):
    """Slip limits along the tissue that grow with the torque carried."""

    relatives = ("layered_friction", "loose_load", "torque_gain")
    redundant_with = ("friction_nmm_per_100mm",)
    resistive = True

    coefficient_per_100mm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=0.5,
        typical=0.05,
        smallest=0.01,
        literature=(0.0, 0.3),
        unit="1 per 100 mm",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add μ times each node's length of tissue."""
        added = 10.0 * self.coefficient_per_100mm * rod.tissue_length_m
        return replace(rod, slip_per_torque=rod.slip_per_torque + added)
