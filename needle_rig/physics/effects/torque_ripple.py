"""The torque reading swings a whole number of times a turn of the base.

Law: τ_m = τ + s sin nθ + c (cos nθ − 1), with an integer order n and θ the base encoder's angle: zero where
the encoder reads zero, and where it was tared.

Source: side loads on the torque cell from a bent coupling (n = 1, 2), rollers of a bearing, teeth of a gear
and pole pairs beside it; torque ripple of gears is at the tooth meshing order: Smith, "Gear Noise and
Vibration" (2003), ch. 2; cogging at multiples of the pole pairs: Hanselman, "Brushless Motors" (2012), ch. 4.

Shows best: a full turn, slowly, both ways: the torque swings alike at the same angles of the base in both
directions, before and after the needle slips.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Reading, Trial, parameter
from needle_rig.units import nm

MOST = 60
"""Largest order that is looked for: 6° of the base, four samples at 45°/s and 50 Hz."""


def orders(trials: Sequence[Trial]) -> list[tuple[int]]:  # noqa: ARG001 see ParameterInfo.places
    """The orders to try."""
    return [(order,) for order in range(1, MOST + 1)]


@dataclass(frozen=True)
class TorqueRipple(Effect):
    """Error of the torque that varies n times a turn of the base."""

    relatives = ("torque_nonlinearity", "torque_bias")

    sine_nmm: float = parameter(
        off=0.0,
        lower=-0.5,
        upper=0.5,
        typical=0.01,
        smallest=0.002,
        literature=(-0.05, 0.05),
        unit="N·mm",
    )
    cosine_nmm: float = parameter(
        off=0.0,
        lower=-0.5,
        upper=0.5,
        typical=0.01,
        smallest=0.001,
        literature=(-0.05, 0.05),
        unit="N·mm",
    )
    order: float = parameter(
        off=1.0,
        lower=1.0,
        upper=1000.0,
        typical=12.0,
        smallest=1.0,
        literature=(1.0, 200.0),
        unit="1",
        shapes=True,
        places=orders,
    )

    def observe(self, reading: Reading) -> Reading:
        """Add the ripple at the base's angle to every torque sample."""
        phase_rad = self.order * reading.trial.base_angle_rad
        ripple_nm = nm(self.sine_nmm) * np.sin(phase_rad) + nm(self.cosine_nmm) * (np.cos(phase_rad) - 1.0)
        return replace(reading, torque_nm=reading.torque_nm + ripple_nm)
