"""The torque cell's curve is not straight.

Law: τ_m = τ + q τ² + c τ³.

Source: polynomials of second and third order by which ISO 376 and ASTM E74 describe such cells; with what
coefficients depends on how far the cell is loaded: 0.5 1/N·mm is 5 % of a reading of 0.1 N·mm.

Shows best: known torques of several sizes and both signs. Within a series: the ratio of torque to lag that
differs between small and large turns (c) or between the directions (q).
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, Reading, parameter
from needle_rig.units import nm


@dataclass(frozen=True)
class TorqueNonlinearity(Effect):
    """Square and cube of the torque in its reading."""

    relatives = ("torque_gain", "torque_bias", "direction_asymmetry")

    square_per_nmm: float = parameter(
        off=0.0,
        lower=-5.0,
        upper=5.0,
        typical=0.5,
        smallest=0.2,
        literature=(-1.0, 1.0),
        unit="1/N·mm",
    )
    cube_per_nmm2: float = parameter(
        off=0.0,
        lower=-50.0,
        upper=50.0,
        typical=5.0,
        smallest=2.0,
        literature=(-10.0, 10.0),
        unit="1/(N·mm)²",
    )

    def observe(self, reading: Reading) -> Reading:
        """Bend every torque sample."""
        square, cube = self.square_per_nmm / nm(1.0), self.cube_per_nmm2 / nm(1.0) ** 2
        torque_nm = reading.torque_nm
        return replace(reading, torque_nm=torque_nm + square * torque_nm**2 + cube * torque_nm**3)
