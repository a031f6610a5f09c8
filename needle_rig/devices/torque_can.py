"""The torque node on the CAN bus: newest good torque and its age."""

from __future__ import annotations

import math

from needle_rig.devices.link_clock import LinkClock
from needle_rig.rig import RawReadings
from needle_rig.wire.can_frames import TORQUE_OK, TorqueStatus

_COMPLAINTS = {
    TORQUE_OK: "",
    1: "the node is still starting",
    2: "the cell is saturated",
    3: "the node reports a sensor fault",
}


class TorqueCan:
    """A torque that the node does not vouch for (starting, saturated, broken) counts as none."""

    def __init__(self, clock_period_s: float, raw: RawReadings | None = None) -> None:
        self._clock = LinkClock(clock_period_s)
        self._raw = raw
        self.torque_nm = math.nan
        self.complaint = ""
        """What is wrong with frames that do come, for the message of a missing link."""

    def take(self, status: TorqueStatus, now_s: float) -> None:
        """A frame whose checksum was right."""
        if self._raw is not None:
            self._raw("torque", (now_s, status.node_time_s, float(status.counter), status.torque_nm))
        self.complaint = _COMPLAINTS.get(status.state, f"the node is in state {status.state}")
        if status.state == TORQUE_OK and self._clock.accept(status.counter, status.node_time_s, now_s):
            self.torque_nm = status.torque_nm

    def age_s(self, now_s: float) -> float:
        """Time since the newest good torque was sampled; infinite before the first."""
        return self._clock.age_s(now_s)
