"""One sentence that says what this effect is.

Law: τ = −k θ where x > x_0, 0 elsewhere: the formula, and what holds the needle. Replace it.

Source: where the law and its sizes come from: a paper, a measurement, a guess.

Shows best: the trial in which it shows, and where: the sensors beyond x_0, in a long hold.
"""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.physics.effect import Effect, parameter

M_PER_MM = 1e-3


@dataclass(frozen=True)
class MyThing(Effect):
    """Torque of a spring along the needle from one place on."""

    # N per rad is N·m per metre of needle and radian: the unit ends the name
    stiffness_n_per_rad: float = parameter(
        off=0.0,  # here the effect vanishes
        lower=0.0,  # a value outside lower to upper is refused
        upper=1e-2,
        typical=1e-4,  # the size of `--effect NAME`
        smallest=1e-5,  # below it the effect does not matter
        literature=(0.0, 1e-3),  # the plausible range
        unit="N/rad",
    )
    place_mm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=2000.0,
        typical=300.0,
        smallest=5.0,
        literature=(175.0, 395.0),
        unit="mm",
        shapes=True,  # it gives form only: it has no value at which the effect vanishes
    )

    # plain Python that is compiled: numbers, the fields above and functions of math
    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:  # noqa: ARG002
        """Torque on the needle, N·m per metre of its length."""
        if position_m < self.place_mm * M_PER_MM:
            return 0.0
        return -self.stiffness_n_per_rad * angle_rad
