"""A law that no library holds, for the demo to hide: a slit that turns a flat needle into it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needle_rig.physics.effect import Effect, parameter
from needle_rig.physics.rod import Layout
from needle_rig.units import N_PER_NMM_PER_100MM
from needle_rig.workbench.laws.law import Law

SECTION = 3
SLIT = Law("torque", f"section_{SECTION}", "angle")
"""What is to be found."""
TYPICAL_NMM_PER_100MM = 0.24
"""Two and a half times the shipped rig's friction: the section is a fifth of its tissue."""


@dataclass(frozen=True)
class SlitTorque(Effect):
    """A torque −a sin 2θ along one section, zero where the needle's flat lies in the slit."""

    sine_nmm_per_100mm: float = parameter(
        off=0.0,
        lower=-2.0,
        upper=2.0,
        typical=TYPICAL_NMM_PER_100MM,
        smallest=0.02,
        literature=(-2.0, 2.0),
        unit="N·mm per 100 mm",
    )
    start_m: float = parameter(
        off=0.0,
        lower=0.0,
        upper=10.0,
        typical=0.0,
        smallest=0.0,
        literature=(0.0, 10.0),
        unit="m",
        shapes=True,
    )
    end_m: float = parameter(
        off=0.0,
        lower=0.0,
        upper=10.0,
        typical=0.0,
        smallest=0.0,
        literature=(0.0, 10.0),
        unit="m",
        shapes=True,
    )

    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:  # noqa: ARG002 see Effect
        """Towards the slit."""
        if position_m < self.start_m or position_m > self.end_m:
            return 0.0
        return -self.sine_nmm_per_100mm * math.sin(2.0 * angle_rad) * N_PER_NMM_PER_100MM


def slit(layout: Layout) -> SlitTorque:
    """The law in the section of a layout. Raises IndexError where it has fewer sections."""
    start_m, end_m = layout.tissue_sections_m[SECTION - 1]
    return SlitTorque(TYPICAL_NMM_PER_100MM, start_m, end_m)


def in_words(law: SlitTorque) -> str:
    """What was hidden, for a person."""
    where = SLIT.words().partition(" depends on ")
    return f"{where[0]}, {-law.sine_nmm_per_100mm:g} · sin(2 · v) N·mm per 100 mm with v {where[2]}"
