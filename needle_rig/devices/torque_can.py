"""The torque node on the CAN bus: newest good torque and its age."""

from __future__ import annotations

from needle_rig.config.files import find_config_file
from needle_rig.config.schema import NodeDevice
from needle_rig.devices.device import Host, TorqueSensor
from needle_rig.devices.link_clock import LinkClock
from needle_rig.devices.shortest_way import CRYSTAL_TOLERANCE
from needle_rig.wire.can_frames import TORQUE_OK, TORQUE_STATUS_ID, TorqueStatus, load_codec

_COMPLAINTS = {
    TORQUE_OK: "",
    1: "the node is still starting",
    2: "the cell is saturated",
    3: "the node reports a sensor fault",
}


class TorqueCan(TorqueSensor):
    """A torque that the node does not vouch for (starting, saturated, broken) counts as none."""

    Options = NodeDevice

    def __init__(self, options: NodeDevice, host: Host) -> None:  # noqa: ARG002 a node has none
        self._host = host
        self._codec = load_codec(find_config_file("needle_rig.dbc"))
        self.link = host.can(self._receive)
        self._clock = LinkClock(self._codec.torque_clock_period_s, CRYSTAL_TOLERANCE)
        self._complaint = ""

    def complaint(self, now_s: float) -> str:  # noqa: ARG002
        """What is wrong with frames that do come, for the message of a missing link."""
        return self._complaint

    def age_s(self, now_s: float) -> float:
        """Time since the newest good torque was sampled; infinite before the first."""
        return self._clock.age_s(now_s)

    def _receive(self, frame_id: int, data: bytes, now_s: float) -> None:
        status = self._codec.decode(frame_id, data) if frame_id == TORQUE_STATUS_ID else None
        if not isinstance(status, TorqueStatus):
            return
        self._host.record("torque", (now_s, status.node_time_s, float(status.counter), status.torque_nm))
        self._complaint = _COMPLAINTS.get(status.state, f"the node is in state {status.state}")
        if status.state == TORQUE_OK and self._clock.accept(status.counter, status.node_time_s, now_s):
            self.torque_nm = status.torque_nm
