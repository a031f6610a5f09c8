"""The Hall node on its serial port: angles of all sensors, unwrapped, with their age."""

from __future__ import annotations

from needle_rig.config.schema import SerialSection
from needle_rig.devices.device import Host
from needle_rig.devices.link_clock import LinkClock
from needle_rig.devices.multi_turn import MultiTurnHall
from needle_rig.devices.shortest_way import CRYSTAL_TOLERANCE
from needle_rig.wire.hall_frames import CLOCK_PERIOD_S, HallFrame, HallStream


class HallSerial(MultiTurnHall):
    """Our own Hall node. A sensor whose magnet is out of reach has no usable reading."""

    Options = SerialSection

    def __init__(self, options: SerialSection, host: Host) -> None:
        super().__init__(host, LinkClock(CLOCK_PERIOD_S, CRYSTAL_TOLERANCE))
        self.link = host.serial(options.port, options.baud, self._receive)
        self._stream = HallStream()
        self.frame: HallFrame | None = None
        """The newest frame, with its field amplitudes; for calibration."""

    def _receive(self, data: bytes, now_s: float) -> None:
        """Every frame is recorded and judged; of those that came at once the newest has the angles."""
        newest: HallFrame | None = None
        for frame in self._stream.feed(data):
            self._host.record("hall", (now_s, frame.node_time_s, float(frame.counter), *frame.angle_rad))
            if self._fits(len(frame.angle_rad)) and self._clock.accept(
                frame.counter, frame.node_time_s, now_s
            ):
                newest = frame
        if newest is not None:
            self.frame = newest
            self._turns.take(newest.angle_rad, newest.complaints, now_s, self._host.base_rad())
            self.angle_rad = self._turns.angle_rad
