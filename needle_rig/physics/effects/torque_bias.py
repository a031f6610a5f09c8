"""The torque cell reads a constant more than the truth.

Law: τ_m = τ + b₀.

Source: zero error of strain-gauge cells after taring, as in any cell's data sheet.

Shows best: the cell's reading at rest before the first motion, where the true torque is zero; and that it
keeps its sign when the direction of the trial is turned round.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, Reading, parameter
from needle_rig.units import nm


@dataclass(frozen=True)
class TorqueBias(Effect):
    """Constant offset of the torque reading."""

    relatives = ("torque_drift", "direction_asymmetry", "bending_torque")

    bias_nmm: float = parameter(
        off=0.0,
        lower=-1.0,
        upper=1.0,
        typical=0.02,
        smallest=0.002,
        literature=(-0.05, 0.05),
        unit="N·mm",
    )

    def observe(self, reading: Reading) -> Reading:
        """Add the bias to every torque sample."""
        return replace(reading, torque_nm=reading.torque_nm + nm(self.bias_nmm))
