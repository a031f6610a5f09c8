"""The needle is deeper in the tissue than the layout says.

Law: a needle pushed in by δ more: l_in → l_in − δ, L → L + δ: the first free length is shorter and the last
section longer; what lies between comes nearer to the base by δ. Tip, needle length and the friction per
length stay. Nearly the same are a last section that rubs more and a stiffer chuck (the free length winds up).

Source: Reed, BioRob 2008, equations (6) and (7), with both lengths off by δ.

Shows best: the first settled state: close to an error of the friction level, but with too much lag beyond the
last section's start and too little before the entry.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import m, mm


@dataclass(frozen=True)
class InsertionDepth(Effect):
    """Shift of everything before the last section towards the base, and a longer last section."""

    part = "needle"
    relatives = ("guide_friction", "layered_friction", "tip_friction", "chuck_compliance")
    redundant_with = ("friction_nmm_per_100mm",)
    resistive = True

    deeper_mm: float = parameter(
        off=0.0,
        lower=-50.0,
        upper=50.0,
        typical=8.0,
        smallest=2.0,
        literature=(-15.0, 15.0),
        unit="mm",
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Move the mesh and scale what acts per length in the last section.

        Raises BadInput when the shift is longer than the free length or the last section.
        """
        deeper_m = m(self.deeper_mm)
        sections = rod.layout.tissue_sections_m
        if not sections:
            return rod
        (start_m, end_m), entry_m = sections[-1], sections[0][0]
        if deeper_m >= entry_m or -deeper_m >= end_m - start_m:
            raise BadInput(
                f"insertion_depth.deeper_mm: {self.deeper_mm:g} mm does not fit a free length of"
                f" {mm(entry_m):g} mm and a last section of {mm(end_m - start_m):g} mm"
            )
        stretch = (end_m - start_m + deeper_m) / (end_m - start_m)

        def moved(position_m: np.ndarray) -> np.ndarray:
            inside = end_m - (end_m - position_m) * stretch
            shifted = np.where(position_m < start_m, position_m - deeper_m, inside)
            return np.where(position_m <= 0, position_m, np.where(position_m > end_m, position_m, shifted))

        position_m = moved(rod.position_m)
        last = (rod.tissue_length_m > 0) & (rod.section == len(sections) - 1)
        scale = np.where(last, stretch, 1.0)
        layout = replace(
            rod.layout,
            tissue_sections_m=tuple((float(a), float(b)) for a, b in moved(np.array(sections))),
            sensor_positions_m=tuple(float(x) for x in moved(np.array(rod.layout.sensor_positions_m))),
        )
        return replace(
            rod,
            layout=layout,
            position_m=position_m,
            tissue_length_m=rod.tissue_length_m * scale,
            stiffness_nm_per_rad=rod.stiffness_nm_per_rad * np.diff(rod.position_m) / np.diff(position_m),
            slip_plus_nm=rod.slip_plus_nm * scale,
            slip_minus_nm=rod.slip_minus_nm * scale,
            compliance_rad_per_nm=rod.compliance_rad_per_nm / scale,
            creep_stiffness_nm_per_rad=rod.creep_stiffness_nm_per_rad * scale,
            creep_viscosity_nms_per_rad=rod.creep_viscosity_nms_per_rad * scale,
            viscous_nms_per_rad=rod.viscous_nms_per_rad * scale,
            laws=tuple(replace(law, weight_m=law.weight_m * scale) for law in rod.laws),
        )
