"""The Hall node on its serial port: angles of all sensors, unwrapped, with their age."""

from __future__ import annotations

from needle_rig.config.schema import SerialSection
from needle_rig.devices.device import HallSensors, Host
from needle_rig.devices.link_clock import LinkClock
from needle_rig.wire.hall_frames import CLOCK_PERIOD_S, HallFrame, HallStream
from needle_rig.wire.hall_turns import HallTurns


class HallSerial(HallSensors):
    """Newest angle of every sensor. A sensor whose magnet is out of reach keeps its value and grows old.

    After an outage the base's angle tells the turns.
    """

    Options = SerialSection

    def __init__(self, options: SerialSection, host: Host) -> None:
        self._host = host
        self.link = host.serial(options.port, options.baud, self._receive)
        self._stream = HallStream()
        self._clock = LinkClock(CLOCK_PERIOD_S)
        self._turns = HallTurns(host.sensors)
        self._misfit = ""
        self.angle_rad = self._turns.angle_rad
        self.frame: HallFrame | None = None
        """The newest frame, with its field amplitudes; for calibration."""

    def complaint(self, now_s: float) -> str:  # noqa: ARG002
        """What is wrong with frames that do come, for the message of a missing link."""
        return self._misfit or self._turns.complaint

    def refer(self, base_rad: float) -> None:
        """The base stands at `base_rad`: sensors whose turns were lost take those nearest to it."""
        self._turns.refer(base_rad)

    def age_s(self, now_s: float) -> float:
        """Age of the oldest sensor's newest value; infinite until every sensor gave one."""
        return max(self._clock.age_s(now_s), now_s - self._turns.healthy_s)

    def _receive(self, data: bytes, now_s: float) -> None:
        for frame in self._stream.feed(data):
            self._take(frame, now_s)

    def _take(self, frame: HallFrame, now_s: float) -> None:
        self._host.record("hall", (now_s, frame.node_time_s, float(frame.counter), *frame.angle_rad))
        wanted = len(self._host.sensors)
        if len(frame.angle_rad) != wanted:
            self._misfit = f"the node sends {len(frame.angle_rad)} sensors, layout.hall_sensors has {wanted}"
            return
        self._misfit = ""
        if not self._clock.accept(frame.counter, frame.node_time_s, now_s):
            return
        self.frame = frame
        self._turns.take(frame.angle_rad, frame.complaints, now_s, self._host.base_rad())
        self.angle_rad = self._turns.angle_rad
