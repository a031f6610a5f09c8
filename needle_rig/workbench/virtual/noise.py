"""How imperfect the simulated rig is."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from needle_rig.errors import BadInput


@dataclass(frozen=True)
class Noise:
    """Imperfections of the simulated rig; the defaults are those of the practice datasets.

    Sensor noise is white, standard deviations. Friction differs from trial to trial, and the needle's
    torsional rigidity from what the dataset says of it, by the given fractions (standard deviations).
    """

    hall_deg: float = 0.25
    torque_nmm: float = 0.0008
    encoder_deg: float = 0.02
    friction_scatter: float = 0.02
    rigidity_error: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0):
                raise BadInput(f"noise: {field.name} is {value:g}; give a number from 0 on")


NO_NOISE = Noise(0.0, 0.0, 0.0, 0.0, 0.0)
