"""Angle sensors behind a small controller that sends lines of text over a serial port."""

from __future__ import annotations

import math

from needle_rig.config.schema import TextHall
from needle_rig.devices.device import Host
from needle_rig.devices.link_clock import LinkClock
from needle_rig.devices.multi_turn import MultiTurnHall
from needle_rig.units import rad
from needle_rig.wire.text_lines import CLOCK_MODULUS, TextLine, TextStream

_TICK_S = {"ms": 1e-3, "us": 1e-6}
_SHOWN_BYTES = 40


class HallText(MultiTurnHall):
    """Lines of a clock and an angle a sensor; nan is no usable reading.

    A line counts when its clock went on: a controller that repeats itself, or a buffer that lags, shows.
    """

    Options = TextHall

    def __init__(self, options: TextHall, host: Host) -> None:
        self._tick_s = _TICK_S[options.clock]
        super().__init__(host, LinkClock(CLOCK_MODULUS * self._tick_s))
        self.link = host.serial(options.port, options.baud, self._receive)
        self._stream = TextStream(checksum=options.checksum)
        self._unit_rad = {"deg": rad(1.0), "rad": 1.0}.get(
            options.angle, math.tau / (options.counts_per_turn or 1)
        )

    def complaint(self, now_s: float) -> str:
        """What is wrong with lines that do come, for a person; empty when nothing is."""
        if self._stream.damaged:
            shown = self._stream.damaged[:_SHOWN_BYTES].decode("ascii", "replace")
            return f"a line cannot be read: {shown!r}; wanted is a clock, then an angle a sensor"
        return super().complaint(now_s)

    def _receive(self, data: bytes, now_s: float) -> None:
        for line in self._stream.feed(data):
            self._take(line, now_s)

    def _take(self, line: TextLine, now_s: float) -> None:
        if not self._fits(len(line.values)):
            return
        node_time_s = line.clock * self._tick_s
        # 359.9° and -0.1° are one place: like the node's, a first angle lies within half a turn of zero
        angle_rad = tuple(math.remainder(value * self._unit_rad, math.tau) for value in line.values)
        self._host.record("hall", (now_s, node_time_s, float(line.clock), *angle_rad))
        if not self._clock.accept(line.clock, node_time_s, now_s):
            return
        unusable = ["says nan: its sensor does not answer" if math.isnan(a) else "" for a in angle_rad]
        self._turns.take(angle_rad, unusable, now_s, self._host.base_rad())
        self.angle_rad = self._turns.angle_rad
