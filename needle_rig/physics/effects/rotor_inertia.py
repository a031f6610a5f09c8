"""The rotor, or a load that is fixed to it, needs torque to be accelerated.

Law: τ_m = τ + J α, α the base's acceleration: between two samples the base turns evenly, so that the mean of
α around a sample is the change of the rate there over half of both intervals.

Source: Newton's law. A servo motor's rotor of 50 g and 10 mm radius has ½ m r² = 25 g·cm².

Shows best: start and stop of a fast motion: a peak of the torque each way, none at even speed and at rest.
It shows only where several samples fall into the acceleration.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.base_motion import acceleration_rad_s2
from needle_rig.physics.effect import Effect, Reading, parameter

KG_M2_PER_G_CM2 = 1e-7


@dataclass(frozen=True)
class RotorInertia(Effect):
    """Moment of inertia that the drive accelerates; that of a needle's is in its chuck."""

    part = "drive"
    relatives = ("torque_low_pass", "clock_offset", "bearing_drag", "viscous_slip")
    stage = -2

    inertia_gcm2: float = parameter(
        off=0.0,
        lower=0.0,
        upper=1e7,
        typical=20.0,
        smallest=5.5,
        literature=(0.1, 1e6),
        unit="g·cm²",
    )

    def observe(self, reading: Reading) -> Reading:
        """Add the torque that accelerates J to every torque sample."""
        alpha_rad_s2 = acceleration_rad_s2(reading.trial.time_s, reading.trial.base_angle_rad)
        inertia_kgm2 = self.inertia_gcm2 * KG_M2_PER_G_CM2
        return replace(reading, torque_nm=reading.torque_nm + inertia_kgm2 * alpha_rad_s2)
