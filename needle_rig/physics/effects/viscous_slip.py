"""Slipping costs more torque the faster the needle turns in the tissue.

Law: τ_t = υ sign(w) + b′ w per length while slipping at the rate w.

Source: Reed, BioRob 2008: b = 2.8 N·mm·s per 100 mm from steady turns at 0.08 rad/s (a value that makes the
free needle relax in 9.4 s, against the 3.0 s that the paper waits).

Shows best: the same turn at two base rates: the torque before the stop differs, and settles exponentially.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import per_length_n


@dataclass(frozen=True)
class ViscousSlip(Effect):
    """Damping of the slip, per length of tissue."""

    relatives = ("stribeck", "tissue_viscoelasticity", "clock_offset")
    resistive = True

    viscosity_nmms_per_rad_per_100mm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=10.0,
        typical=0.05,
        smallest=0.0025,
        literature=(0.0, 2.8),
        unit="N·mm·s/rad per 100 mm",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add b′·length to the viscous torque of every tissue node."""
        added = per_length_n(self.viscosity_nmms_per_rad_per_100mm) * rod.tissue_length_m
        return replace(rod, viscous_nms_per_rad=rod.viscous_nms_per_rad + added)
