"""The torque cell reads a multiple of the truth.

Law: τ_m = g τ.

Source: calibration error of the cell; a gain of 0.54 alone would explain the 26° → 12° of Reed, BioRob 2008.
All angles depend on ratios to JG only, so that a gain and JG cannot be told apart without a known torque.

Shows best: hang a known torque on the cell. Within a series: the ratio of torque to lag, the same in every
motion, against the stated needle constants.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, Reading, parameter


@dataclass(frozen=True)
class TorqueGain(Effect):
    """Factor on the torque reading."""

    relatives = ("tissue_elasticity", "chuck_compliance", "friction_wear")
    redundant_with = ("torsional_rigidity_nmm2",)
    stage = -1

    gain: float = parameter(
        off=1.0,
        lower=0.05,
        upper=5.0,
        typical=0.8,
        smallest=0.98,
        literature=(0.5, 1.5),
        unit="1",
    )

    def observe(self, reading: Reading) -> Reading:
        """Multiply every torque sample."""
        return replace(reading, torque_nm=reading.torque_nm * self.gain)
