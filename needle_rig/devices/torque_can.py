"""The torque node on the CAN bus: newest good torque and its age."""

from __future__ import annotations

import math

from needle_rig.config.files import find_config_file
from needle_rig.config.schema import NodeDevice
from needle_rig.devices.device import Host, TorqueSensor
from needle_rig.devices.link_clock import LinkClock
from needle_rig.devices.shortest_way import CRYSTAL_TOLERANCE
from needle_rig.records import Firmware
from needle_rig.wire.can_frames import (
    TORQUE_CALIBRATION_ID,
    TORQUE_FIRMWARE_ID,
    TORQUE_OK,
    TORQUE_STATUS_ID,
    TorqueStatus,
    load_codec,
)
from needle_rig.wire.node_identity import NodeIdentity

_IDS = (TORQUE_STATUS_ID, TORQUE_FIRMWARE_ID, TORQUE_CALIBRATION_ID)
_COMPLAINTS = {
    TORQUE_OK: "",
    1: "the node is still starting",
    2: "the cell is saturated",
    3: "the node reports a sensor fault",
}


class TorqueCan(TorqueSensor):
    """A torque that the node does not vouch for (starting, saturated, broken) counts as none.

    So does one of a node whose protocol is not known.
    """

    Options = NodeDevice

    def __init__(self, options: NodeDevice, host: Host) -> None:  # noqa: ARG002 a node has none
        self._host = host
        self._codec = load_codec(find_config_file("needle_rig.dbc"))
        self.link = host.can(self._receive)
        self._clock = LinkClock(self._codec.torque_clock_period_s, CRYSTAL_TOLERANCE)
        self._complaint = ""
        self._identity = NodeIdentity(self._codec, "torque")

    def complaint(self, now_s: float) -> str:  # noqa: ARG002
        """What is wrong with frames that do come, for a person; empty when nothing is."""
        return self._identity.refusal or self._complaint

    def firmware(self, now_s: float) -> Firmware:
        """What the node says of its firmware."""
        return self._identity.told(now_s)

    def age_s(self, now_s: float) -> float:
        """Time since the newest good torque was sampled; infinite before the first."""
        return math.inf if self._identity.refusal else self._clock.age_s(now_s)

    def _receive(self, frame_id: int, data: bytes, now_s: float) -> None:
        status = self._codec.decode(frame_id, data) if frame_id in _IDS else None
        self._identity.take(status, now_s)
        if not isinstance(status, TorqueStatus) or self._identity.refusal:
            return
        self._host.record("torque", (now_s, status.node_time_s, float(status.counter), status.torque_nm))
        self._complaint = _COMPLAINTS.get(status.state, f"the node is in state {status.state}")
        if status.state == TORQUE_OK and self._clock.accept(status.counter, status.node_time_s, now_s):
            self.torque_nm = status.torque_nm
