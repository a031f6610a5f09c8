"""A load-cell amplifier that prints its milliseconds and a torque: `1234 +0.0125 Nm`."""

import re

from needle_rig.config.schema import Section
from needle_rig.devices.device import TorqueSensor
from needle_rig.devices.link_clock import LinkClock

LINE = re.compile(rb"([0-9]+) ([-+][0-9.]+) Nm")


class Amplifier(TorqueSensor):
    class Options(Section):
        port: str
        baud: int = 9600

    def __init__(self, options, host):
        self.host, self.rest = host, b""
        self.link = host.serial(options.port, options.baud, self.received)
        self.clock = LinkClock(2**32 * 1e-3)

    def age_s(self, now_s):
        return self.clock.age_s(now_s)

    def received(self, data, now_s):
        *lines, self.rest = (self.rest + data)[-1000:].split(b"\n")
        for line in lines:
            found = LINE.fullmatch(line.strip())
            if found is None:
                continue
            count, torque_nm = int(found[1]), float(found[2])
            self.host.record("torque", (now_s, count * 1e-3, float(count), torque_nm))
            if self.clock.accept(count, count * 1e-3, now_s):
                self.torque_nm = torque_nm

    @classmethod
    def simulated(cls, options):
        return Twin()


class Twin:
    """The amplifier as its manual has it: a line every 4 ms."""

    torque_nm = 0.0

    def reset(self, now_s):
        self.start_s = now_s

    def receive(self, now_s, frame_id, data):
        """It does not listen."""

    def step(self, now_s):
        count = round((now_s - self.start_s) * 1e3)
        return [] if count % 4 else [(0, b"%d %+.6f Nm\r\n" % (count, self.torque_nm))]

    def page(self, path):
        raise KeyError(path)
