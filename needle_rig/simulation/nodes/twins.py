"""The simulated devices of other makes in SI, as the devices' contract takes them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from needle_rig.config.schema import Cia402Drive, NetFtTorque, TextHall
from needle_rig.simulation.nodes.cia402_node import Cia402Node
from needle_rig.simulation.nodes.front_end import (
    ENCODER_COUNTS_PER_DEG,
    HALL_AMPLITUDE_COUNTS,
    TORQUE_COUNTS_PER_NMM,
)
from needle_rig.simulation.nodes.netft_sensor import NetFtSensor
from needle_rig.simulation.nodes.slcan_hub import Frame
from needle_rig.simulation.nodes.text_sensors import TextSensors
from needle_rig.units import deg, nmm

_TOO_HOT = 0x4210


class DriveTwin:
    """A CiA 402 drive; `angle_rad` is its encoder's, `velocity_rad_s` what it asks of its motor."""

    def __init__(self, options: Cia402Drive) -> None:
        self._drive = Cia402Node(options)
        self.angle_rad = self.velocity_rad_s = 0.0

    def reset(self, now_s: float) -> None:
        """See `Twin.reset`."""
        self._drive.reset(_us(now_s))
        self.velocity_rad_s = 0.0

    def receive(self, now_s: float, frame_id: int, data: bytes) -> None:
        """See `Twin.receive`."""
        self._drive.receive(_us(now_s), frame_id, data)

    def step(self, now_s: float) -> tuple[Frame, ...]:
        """See `Twin.step`."""
        counts = round(deg(self.angle_rad) * ENCODER_COUNTS_PER_DEG)
        frames, self.velocity_rad_s = self._drive.step(_us(now_s), counts)
        return frames

    def fail(self) -> None:
        """It is too hot."""
        self._drive.fail(_TOO_HOT)

    def page(self, path: str) -> bytes:
        """It serves none."""
        raise KeyError(path)


class NetFtTwin:
    """An ATI Net F/T that feels `torque_nm`."""

    def __init__(self, options: NetFtTorque) -> None:
        self._sensor = NetFtSensor(options)
        self.torque_nm = 0.0

    def reset(self, now_s: float) -> None:
        """See `Twin.reset`."""
        self._sensor.reset(_us(now_s))

    def receive(self, now_s: float, frame_id: int, data: bytes) -> None:  # noqa: ARG002
        """See `Twin.receive`."""
        self._sensor.receive(data)

    def step(self, now_s: float) -> tuple[Frame, ...]:
        """See `Twin.step`."""
        record = self._sensor.step(_us(now_s), round(nmm(self.torque_nm) * TORQUE_COUNTS_PER_NMM))
        return ((0, record),) if record else ()

    def page(self, path: str) -> bytes:  # noqa: ARG002 it has one
        """See `Twin.page`."""
        return self._sensor.page()


class TextTwin:
    """A small controller with a sensor an angle of `hall_rad`; NaN has no magnet."""

    def __init__(self, options: TextHall) -> None:
        self._sensors = TextSensors(options)
        self._start_us = 0
        self.hall_rad: tuple[float, ...] = (0.0,) * 4

    def reset(self, now_s: float) -> None:
        """See `Twin.reset`."""
        self._start_us = _us(now_s)
        self._sensors.reset()

    def receive(self, now_s: float, frame_id: int, data: bytes) -> None:
        """It does not listen."""

    def step(self, now_s: float) -> tuple[Frame, ...]:
        """See `Twin.step`."""
        pairs = [(0, 0) if math.isnan(angle) else _pair(angle) for angle in self.hall_rad]
        line = self._sensors.step(_us(now_s) - self._start_us, pairs)
        return ((0, line),) if line else ()

    def page(self, path: str) -> bytes:
        """It serves none."""
        raise KeyError(path)


TWINS: Mapping[str, Callable[[Any], DriveTwin | NetFtTwin | TextTwin]] = MappingProxyType(
    {"cia402": DriveTwin, "netft": NetFtTwin, "text": TextTwin}
)
"""By the word of the rig file."""


def _us(time_s: float) -> int:
    return round(time_s * 1e6)


def _pair(angle_rad: float) -> tuple[int, int]:
    return (
        round(HALL_AMPLITUDE_COUNTS * math.sin(angle_rad)),
        round(HALL_AMPLITUDE_COUNTS * math.cos(angle_rad)),
    )
