"""Sensors, converters and bridge between the plant and the firmware, with the errors that real ones have."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from needle_rig.records import Measurement
from needle_rig.simulation.nodes.front_end import TORQUE_COUNTS_PER_NMM, TORQUE_FULL_SCALE, Inputs
from needle_rig.units import nmm, rad

ADC_MID, ADC_MAX = 2048, 4095
HALL_AMPLITUDE = 1700.0
"""Counts of 12 bits: room for offsets."""
COUNTS_PER_TURN = 360_000
FULL_DUTY_RAD_S = rad(180.0)
BRIDGE_STEP = 8
"""The board's bridge has 12 bits of the duty's 15."""


@dataclass(frozen=True)
class HallErrors:
    """One Hall sensor: counts of offset, gains, its angle against the base, eccentricity of its magnet."""

    sine_offset: float = 0.0
    cosine_offset: float = 0.0
    sine_gain: float = 1.0
    cosine_gain: float = 1.0
    zero_rad: float = 0.0
    eccentricity_rad: tuple[float, float] = (0.0, 0.0)
    phase_rad: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class SensorErrors:
    """What is wrong with every sensor of a rig."""

    hall: tuple[HallErrors, ...] = ()
    torque_offset_counts: float = 0.0
    torque_gain: float = 1.0
    encoder_gain: float = 1.0

    @classmethod
    def planted(cls, seed: int, sensors: int) -> SensorErrors:
        """Errors of the size that a rig has before calibration; none for seed 0."""
        if seed == 0:
            return cls((HallErrors(),) * sensors)
        random = np.random.default_rng(seed)

        def hall() -> HallErrors:
            offsets, gains = random.uniform(-90.0, 90.0, 2), random.uniform(0.93, 1.07, 2)
            zero, first, second = random.uniform(-math.pi, math.pi, 3).tolist()
            return HallErrors(
                float(offsets[0]),
                float(offsets[1]),
                float(gains[0]),
                float(gains[1]),
                zero,
                (rad(random.uniform(1.0, 4.0)), rad(random.uniform(0.2, 1.5))),
                (first, second),
            )

        return cls(
            tuple(hall() for _ in range(sensors)),
            float(random.uniform(-40_000.0, 40_000.0)),
            float(random.uniform(0.8, 1.25)),
            float(random.choice((-1.0, 1.0)) * random.uniform(0.9, 1.1)),
        )


@dataclass
class AnalogueFrontEnd:
    """Makes converter counts of what the plant's sensors feel. `weight_nmm` is hung on the torque sensor."""

    errors: SensorErrors
    seed: int = 1
    weight_nmm: float = 0.0
    _random: np.random.Generator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def inputs(self, measurement: Measurement) -> Inputs:
        """Counts of every input: 24-bit load cell, encoder, 12-bit (sine, cosine) of each Hall sensor."""
        torque_nmm = nmm(measurement.torque_nm) + self.weight_nmm
        torque = (
            torque_nmm * TORQUE_COUNTS_PER_NMM * self.errors.torque_gain + self.errors.torque_offset_counts
        )
        # The last bits of a 24-bit converter never stand still.
        torque_counts = round(torque + 4.0 * self._random.standard_normal())
        turns = measurement.base_angle_rad / math.tau
        return Inputs(
            torque=min(max(torque_counts, -TORQUE_FULL_SCALE - 1), TORQUE_FULL_SCALE),
            encoder=round(turns * COUNTS_PER_TURN * self.errors.encoder_gain),
            hall=tuple(
                _pair(angle, errors)
                for angle, errors in zip(measurement.hall_rad, self.errors.hall, strict=True)
            ),
        )

    @staticmethod
    def velocity_rad_s(duty: int) -> float:
        """What the bridge asks of the motor at a duty of ±2¹⁵."""
        return int(duty / BRIDGE_STEP) * BRIDGE_STEP / 32768 * FULL_DUTY_RAD_S


def _pair(angle_rad: float, errors: HallErrors) -> tuple[int, int]:
    seen = angle_rad + errors.zero_rad
    for k, (amplitude, phase) in enumerate(zip(errors.eccentricity_rad, errors.phase_rad, strict=True), 1):
        seen += amplitude * math.sin(k * angle_rad + phase)
    return (
        _converted(HALL_AMPLITUDE * errors.sine_gain * math.sin(seen) + errors.sine_offset),
        _converted(HALL_AMPLITUDE * errors.cosine_gain * math.cos(seen) + errors.cosine_offset),
    )


def _converted(counts: float) -> int:
    return min(max(round(ADC_MID + counts), 0), ADC_MAX)
