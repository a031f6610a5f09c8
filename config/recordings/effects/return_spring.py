"""Something along the way pulls the shaft back to where it rests.

Law: τ = −k (θ − θ₀) per length. It is a spring to the ground, not to the base: seals, cables of other joints
that are bent along, a spring. It rests at θ₀, wherever the recording counts from.

Source: elastic restoring torque of the wrist in cable-driven instruments: Anooshahpour, Polushin, Patel,
"Quasi-static modeling of the da Vinci instrument", IROS 2014.

Shows best: slow turns to and fro: both sides of the loop of torque over angle rise alike.
"""

from dataclasses import dataclass

from needle_rig.physics.effect import Effect, parameter
from needle_rig.units import N_PER_NMM_PER_100MM, RAD_PER_DEG


@dataclass(frozen=True)
class ReturnSpring(Effect):
    """Spring between the shaft and the ground along the tissue."""

    relatives = ("bending_torque", "tissue_elasticity", "torque_gain")

    stiffness_nmm_per_rad_per_100mm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=1.0,
        typical=0.02,
        smallest=0.002,
        literature=(0.0, 0.2),
        unit="N·mm/rad per 100 mm",
    )
    neutral_deg: float = parameter(
        default=0.0,
        off=0.0,
        lower=-180.0,
        upper=180.0,
        typical=-45.0,
        smallest=1.0,
        literature=(-90.0, 90.0),
        unit="°",
        shapes=True,
    )

    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
        """Torque towards the angle of rest."""
        away_rad = angle_rad - self.neutral_deg * RAD_PER_DEG
        return -self.stiffness_nmm_per_rad_per_100mm * away_rad * N_PER_NMM_PER_100MM
