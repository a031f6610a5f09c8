"""Tissue gives way elastically and goes on giving way while it is held: the standard linear solid.

Law: a spring k∞ beside a spring k₁ in series with a dashpot of relaxation time τ, per length, under the
friction υ: τ_t = k∞ u + q, dq/dt = k₁ du/dt − q/τ, with u = θ − p. Solved in the equal creep form: a spring
k∞ + k₁ in series with a Kelvin–Voigt element of stiffness k∞(k∞ + k₁)/k₁ and viscosity τ(k∞ + k₁)²/k₁.
k∞ → 0 is Maxwell's fluid; k₁ → ∞ with k₁τ kept is Kelvin–Voigt's solid; k₁ → 0 is plain elasticity.

Source: Fung, "Biomechanics: mechanical properties of living tissues", ch. 7; relaxation 0.3–30 s in soft
phantoms and liver.

Shows best: long holds after a reversal: the torque falls and the deep sensors creep, and both come back.
Compare a 0.5 s dwell with a 10 s one.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import per_length_n


@dataclass(frozen=True)
class TissueViscoelasticity(Effect):
    """Spring and relaxing spring between needle and tissue, in series with what gives way already."""

    part = "needle"
    relatives = ("tissue_elasticity", "viscous_slip")
    limits = {"tissue_elasticity": {"relaxing_stiffness_nmm_per_rad_per_100mm": 0.0}}  # noqa: RUF012
    resistive = True

    relaxed_stiffness_nmm_per_rad_per_100mm: float = parameter(
        off=float("inf"),
        lower=0.0,
        upper=200.0,
        typical=0.35,
        smallest=20.0,
        literature=(0.1, 2.0),
        unit="N·mm/rad per 100 mm",
        scale="reciprocal",
    )
    relaxing_stiffness_nmm_per_rad_per_100mm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=1e4,
        typical=0.35,
        smallest=0.02,
        literature=(0.05, 4.0),
        unit="N·mm/rad per 100 mm",
        shapes=True,
    )
    relaxation_time_s: float = parameter(
        off=0.0,
        lower=1e-4,
        upper=1000.0,
        typical=2.0,
        smallest=0.1,
        literature=(0.3, 30.0),
        unit="s",
        scale="log",
        shapes=True,
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add 1/(k∞ + k₁) to the compliance of every tissue node, and the creep element."""
        relaxed = per_length_n(self.relaxed_stiffness_nmm_per_rad_per_100mm)
        relaxing = per_length_n(self.relaxing_stiffness_nmm_per_rad_per_100mm)
        glassy = relaxed + relaxing
        tissue = rod.tissue_length_m > 0
        length_m = rod.tissue_length_m[tissue]
        compliance = rod.compliance_rad_per_nm.copy()
        with np.errstate(divide="ignore"):
            compliance[tissue] += 1.0 / (glassy * length_m)
        if relaxing == 0 or np.isinf(relaxed):
            return replace(rod, compliance_rad_per_nm=compliance)
        stiffness = rod.creep_stiffness_nm_per_rad.copy()
        viscosity = rod.creep_viscosity_nms_per_rad.copy()
        stiffness[tissue] = relaxed * glassy / relaxing * length_m
        viscosity[tissue] = self.relaxation_time_s * glassy**2 / relaxing * length_m
        return replace(
            rod,
            compliance_rad_per_nm=compliance,
            creep_stiffness_nm_per_rad=stiffness,
            creep_viscosity_nms_per_rad=viscosity,
        )
