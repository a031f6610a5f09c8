"""What the plant puts on the nodes' inputs: converter and encoder counts, no physical unit."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needle_rig.records import Measurement
from needle_rig.units import deg, nmm

TORQUE_COUNTS_PER_NMM = 100_000
TORQUE_FULL_SCALE = 2**23 - 1
ENCODER_COUNTS_PER_DEG = 1000
HALL_AMPLITUDE_COUNTS = 40_000


@dataclass(frozen=True, slots=True)
class Inputs:
    """One sample of every input: 24-bit torque converter, encoder, (sine, cosine) of each Hall pair."""

    torque: int
    encoder: int
    hall: tuple[tuple[int, int], ...]


def inputs(measurement: Measurement) -> Inputs:
    """The counts that a rig in the state of `measurement` shows to its nodes."""
    torque = round(nmm(measurement.torque_nm) * TORQUE_COUNTS_PER_NMM)
    return Inputs(
        torque=min(max(torque, -TORQUE_FULL_SCALE), TORQUE_FULL_SCALE),
        encoder=round(deg(measurement.base_angle_rad) * ENCODER_COUNTS_PER_DEG),
        hall=tuple(
            (round(HALL_AMPLITUDE_COUNTS * math.sin(angle)), round(HALL_AMPLITUDE_COUNTS * math.cos(angle)))
            for angle in measurement.hall_rad
        ),
    )
