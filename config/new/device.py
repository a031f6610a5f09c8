"""A torque amplifier that prints its milliseconds and a torque: `1234 +0.0125 Nm`. Replace its line."""

from __future__ import annotations

import re

from needle_rig.config.schema import Section
from needle_rig.devices.device import Host, TorqueSensor
from needle_rig.devices.link_clock import LinkClock

LINE = re.compile(rb"([0-9]+) ([-+][0-9.]+) Nm")
COUNTER_S = 2**32 * 1e-3
LONGEST_REST_BYTES = 1000


# derive from Drive, TorqueSensor or HallSensors: needle_rig/devices/device.py says what each must do
class MyThing(TorqueSensor):
    """The host's side: what the device sends, understood."""

    class Options(Section):
        """Keys that stand beside `device` in the rig file."""

        port: str
        baud: int = 9600

    def __init__(self, options: Options, host: Host) -> None:
        self.host, self.rest = host, b""
        self.link = host.serial(options.port, options.baud, self.received)  # open no port yourself
        self.clock = LinkClock(COUNTER_S)

    def age_s(self, now_s: float) -> float:
        """Age of the newest reading, s. It grows when the device repeats itself or falls silent."""
        return self.clock.age_s(now_s)

    def received(self, data: bytes, now_s: float) -> None:
        """Bytes as they come: lines may be cut anywhere, and noise is no reading."""
        *lines, self.rest = (self.rest + data)[-LONGEST_REST_BYTES:].split(b"\n")
        for line in lines:
            found = LINE.fullmatch(line.strip())
            if found is None:
                continue
            count, torque_nm = int(found[1]), float(found[2])
            self.host.record("torque", (now_s, count * 1e-3, float(count), torque_nm))
            if self.clock.accept(count, count * 1e-3, now_s):
                self.torque_nm = torque_nm

    @classmethod
    def simulated(cls, options: Options) -> Twin:  # noqa: ARG003
        """The twin that check-device tries this file against."""
        return Twin()


# written from the maker's manual and not from the class above
class Twin:
    """The amplifier as its manual has it: a line every 4 ms."""

    torque_nm = 0.0

    def reset(self, now_s: float) -> None:
        """It was switched on."""
        self.start_s = now_s

    def receive(self, now_s: float, frame_id: int, data: bytes) -> None:
        """It does not listen."""

    def step(self, now_s: float) -> list[tuple[int, bytes]]:
        """What it sends in this millisecond."""
        count = round((now_s - self.start_s) * 1e3)
        return [] if count % 4 else [(0, b"%d %+.6f Nm\r\n" % (count, self.torque_nm))]

    def page(self, path: str) -> bytes:
        """It has no web page."""
        raise KeyError(path)
