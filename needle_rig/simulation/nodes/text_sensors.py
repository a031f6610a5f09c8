"""Angle sensors behind a small controller whose program prints a line a reading."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Sequence

from needle_rig.config.schema import TextHall
from needle_rig.units import deg

EVERY_US = 4000
"""A line of four angles takes 3 ms at 115200 baud."""
_NO_MAGNET = 1000.0


class TextSensors:
    """`Serial.print(millis())`, then a comma and an angle a sensor; nan where there is no magnet."""

    def __init__(self, options: TextHall) -> None:
        self._options = options
        self.reset()

    def reset(self) -> None:
        """It is switched on."""
        self._printed_us = -EVERY_US

    def step(self, now_us: int, pairs: Sequence[tuple[int, int]]) -> bytes:
        """The line of one reading, or nothing between two."""
        if now_us - self._printed_us < EVERY_US:
            return b""
        self._printed_us = now_us
        clock = now_us if self._options.clock == "us" else now_us // 1000
        fields = [str(clock % 2**32), *(self._angle(sine, cosine) for sine, cosine in pairs)]
        line = ", ".join(fields).encode()
        if self._options.checksum:
            line += b"*%02X" % functools.reduce(operator.xor, line, 0)
        return line + b"\r\n"

    def _angle(self, sine: int, cosine: int) -> str:
        if math.hypot(sine, cosine) < _NO_MAGNET:
            return "nan"
        angle_rad = math.atan2(sine, cosine) % math.tau
        if self._options.angle == "counts":
            turn = self._options.counts_per_turn or 4096
            return str(round(angle_rad / math.tau * turn) % turn)
        return f"{angle_rad:.5f}" if self._options.angle == "rad" else f"{deg(angle_rad):.3f}"
