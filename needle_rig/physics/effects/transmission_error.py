"""A gear between encoder and needle turns unevenly, a whole number of times a turn.

Law: θ_held = θ_base − s sin nθ_base − c (cos nθ_base − 1), with an integer order n: the number of teeth, or
of an encoder's pole pairs; zero where the encoder reads zero.

Source: transmission error of a gear at its tooth meshing order: Smith, "Gear Noise and Vibration" (2003),
ch. 2; error within a pole pair of a magnetic encoder.

Shows best: a full turn, slowly: all sensors that turn swing by the same angle, at the same angles of the
base in both directions, and where the needle is held the torque swings with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.units import rad

MOST = 60
"""Largest order that is looked for: 6° of the base, four samples at 45°/s and 50 Hz."""


def orders(trials: Sequence[Trial]) -> list[tuple[int]]:  # noqa: ARG001 see ParameterInfo.places
    """The orders to try; a turn once a turn is an eccentric disc."""
    return [(order,) for order in range(2, MOST + 1)]


@dataclass(frozen=True)
class TransmissionError(Effect):
    """Error of the base's angle that varies n times a turn."""

    relatives = ("encoder_eccentricity", "hall_harmonics", "chuck_backlash")
    stage = -1

    sine_deg: float = parameter(
        off=0.0,
        lower=-10.0,
        upper=10.0,
        typical=1.0,
        smallest=0.5,
        literature=(-2.0, 2.0),
        unit="°",
    )
    cosine_deg: float = parameter(
        off=0.0,
        lower=-10.0,
        upper=10.0,
        typical=1.0,
        smallest=0.5,
        literature=(-2.0, 2.0),
        unit="°",
    )
    order: float = parameter(
        off=1.0,
        lower=1.0,
        upper=1000.0,
        typical=14.0,
        smallest=1.0,
        literature=(1.0, 200.0),
        unit="1",
        shapes=True,
        places=orders,
    )

    def drive(self, trial: Trial) -> Array:
        """The path of the held end (samples,) in rad."""
        shown_rad = trial.base_angle_rad
        phase_rad = self.order * shown_rad
        error_rad = rad(self.sine_deg) * np.sin(phase_rad) + rad(self.cosine_deg) * (np.cos(phase_rad) - 1.0)
        return shown_rad - error_rad
