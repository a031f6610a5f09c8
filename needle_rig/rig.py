"""The seam between the brain and the world."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from needle_rig.records import Command, Firmware, Measurement

RawReadings = Callable[[str, tuple[float, ...]], None]
"""Receives every raw reading as (source, row), for the record. Rows:
torque: time_s, node_time_s, counter, torque_nm; hall: time_s, node_time_s, counter, one angle_rad a sensor;
drive: time_s, node_time_s, counter, angle_rad, state, faults."""


class Rig(Protocol):
    """A needle-rotation rig: real nodes behind ports, or the plant in virtual time."""

    async def open(self) -> None:
        """Connect and wait for the first reading of every link; RigFault names a missing one."""

    def read(self) -> Measurement:
        """Newest values with their ages; never blocks."""

    def write(self, command: Command) -> None:
        """Send one command; never blocks. A dead link shows in the ages of later readings."""

    def firmware(self) -> dict[str, Firmware]:
        """What each node says of itself, by link; one that cannot tell is not among them. Never blocks."""

    async def close(self) -> None:
        """Stop the drive and release every port; safe to call twice."""
