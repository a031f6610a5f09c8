"""Chuck and coupling between torque cell and needle need torque to be accelerated.

Law: τ_m = τ + J α, α the base's acceleration: between two samples the base turns evenly, so that the mean
of α around a sample is the change of the rate there over half of both intervals.

Source: Newton's law; dynamic torque of shaft inertias in Himmelstein, application note 221101D, "Dynamic
torque measurement". A collet chuck of 30 g and 8 mm radius has ½ m r² = 10 g·cm².

Shows best: start and stop of a fast motion: a peak of the torque each way, none at even speed and at rest.
It shows only where several samples fall into the acceleration.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.base_motion import acceleration_rad_s2
from needle_rig.physics.effect import Effect, Reading, parameter

KG_M2_PER_G_CM2 = 1e-7


@dataclass(frozen=True)
class ChuckInertia(Effect):
    """Moment of inertia of what turns between torque cell and needle."""

    part = "chuck"
    relatives = ("torque_low_pass", "clock_offset", "bearing_drag", "viscous_slip")
    stage = -2

    inertia_gcm2: float = parameter(
        off=0.0,
        lower=0.0,
        upper=1e4,
        typical=20.0,
        smallest=5.5,
        literature=(0.1, 200.0),
        unit="g·cm²",
    )

    def observe(self, reading: Reading) -> Reading:
        """Add the torque that accelerates J to every torque sample."""
        alpha_rad_s2 = acceleration_rad_s2(reading.trial.time_s, reading.trial.base_angle_rad)
        inertia_kgm2 = self.inertia_gcm2 * KG_M2_PER_G_CM2
        return replace(reading, torque_nm=reading.torque_nm + inertia_kgm2 * alpha_rad_s2)
