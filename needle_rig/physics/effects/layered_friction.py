"""Every tissue section rubs with a strength of its own.

Law: υ(x) = f_s υ in section s. Fits hold the mean of f_s at 1: what all sections share is υ.

Source: layers of skin, fat, muscle and organ differ in friction per length: Okamura, Simone, O'Leary, "Force
modeling for needle insertion into soft tissue", IEEE Trans. Biomedical Engineering 51 (2004).

Shows best: settle after a long turn in one direction: the twist between neighbouring sensors gives the
friction beyond them. What is left after the sequence stays the same in every trial.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, PerItem, Trial, parameter
from needle_rig.physics.rod import Rod


@dataclass(frozen=True)
class LayeredFriction(Effect):
    """Factor on the friction of each tissue section."""

    part = "needle"
    relatives = ("tip_friction", "platform_friction", "insertion_depth")
    redundant_with = ("friction_nmm_per_100mm",)
    resistive = True

    factor: PerItem = parameter(
        off=1.0,
        lower=0.0,
        upper=10.0,
        typical=1.5,
        smallest=1.03,
        literature=(0.2, 4.0),
        unit="1",
        per="section",
        relative=True,
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Multiply both slip limits of the tissue nodes of each section."""
        tissue = rod.tissue_length_m > 0
        factor = np.ones_like(rod.position_m)
        factor[tissue] = self.each("factor", len(rod.layout.tissue_sections_m))[rod.section[tissue]]
        return replace(rod, slip_plus_nm=rod.slip_plus_nm * factor, slip_minus_nm=rod.slip_minus_nm * factor)
