"""A curved needle in straight tissue turns home to the angle at which it fits.

Law: τ = −(A sin θ + C cos θ) per length, that is −H sin(θ − ψ) with H = √(A² + C²), tan ψ = −C/A: the needle
rests at θ = ψ and is driven away from ψ + 180°. It depends on the absolute angle, not on the direction.

Source: precurved needles and concentric tubes: Dupont, Lock, Itkowitz, Butler, "Design and control of
concentric-tube robots", IEEE Trans. Robotics 26 (2010); its size, up to that of friction, is an estimate.

Shows best: a full turn forth and back: the torque varies once a turn, with the angle and not with the
direction.
"""

import math
from dataclasses import dataclass

from needle_rig.physics.effect import Effect, parameter
from needle_rig.units import N_PER_NMM_PER_100MM


@dataclass(frozen=True)
class BendingTorque(Effect):
    """Once-a-turn torque along the tissue."""

    part = "needle"
    relatives = ("direction_asymmetry", "torque_bias", "hall_eccentricity")

    sine_nmm_per_100mm: float = parameter(
        off=0.0,
        lower=-2.0,
        upper=2.0,
        typical=0.05,
        smallest=0.0025,
        literature=(-0.15, 0.15),
        unit="N·mm per 100 mm",
    )
    cosine_nmm_per_100mm: float = parameter(
        off=0.0,
        lower=-2.0,
        upper=2.0,
        typical=0.02,
        smallest=0.002,
        literature=(-0.15, 0.15),
        unit="N·mm per 100 mm",
    )

    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
        """Torque towards the angle of rest, N·m per metre."""
        sine = self.sine_nmm_per_100mm * math.sin(angle_rad)
        return -(sine + self.cosine_nmm_per_100mm * math.cos(angle_rad)) * N_PER_NMM_PER_100MM
