"""What one node on the CAN bus said of its firmware, and whether its other frames can be understood."""

from __future__ import annotations

import math

from needle_rig.records import Firmware
from needle_rig.version import VERSION
from needle_rig.wire.can_frames import CanCodec, CanContent, NodeCalibration, NodeFirmware

FORGOTTEN_S = 3.0
"""Each frame comes at 1 Hz: three that are missing mean a firmware that sends none."""


class NodeIdentity:
    """Follows the FIRMWARE and CALIBRATION frames of `node`.

    A node that sends none is older than these frames and speaks the first protocol. One that told another
    protocol is refused until it tells one that is known: its silence proves nothing.
    """

    def __init__(self, codec: CanCodec, node: str) -> None:
        self._known = codec.protocols
        self._node = node
        self._protocol: int | None = None
        self._firmware: NodeFirmware | None = None
        self._calibration: NodeCalibration | None = None
        self._heard_s = -math.inf
        self.refusal = ""
        """Why its other frames are not read, for a person; empty while they are."""

    def take(self, content: CanContent | None, now_s: float) -> None:
        """A frame seen on the bus; those of other nodes and of other kinds say nothing."""
        if not isinstance(content, NodeFirmware | NodeCalibration) or content.node != self._node:
            return
        if content.protocol != self._protocol:  # another firmware: what the one before said is void
            self._protocol, self._firmware, self._calibration = content.protocol, None, None
        if isinstance(content, NodeFirmware):
            self._firmware = content
        else:
            self._calibration = content
        self._heard_s = now_s
        self.refusal = "" if content.protocol in self._known else self._refused()

    def told(self, now_s: float) -> Firmware:
        """What it said last, as far as that still holds."""
        if now_s - self._heard_s > FORGOTTEN_S and not self.refusal:
            return Firmware()
        firmware, calibration = self._firmware, self._calibration
        return Firmware(
            protocol=self._protocol,
            version=None if firmware is None else firmware.version,
            build=None if firmware is None else firmware.build,
            calibrated=None if calibration is None else calibration.serial is not None,
            calibration_serial=None if calibration is None else calibration.serial,
            refusal=self.refusal,
        )

    def _refused(self) -> str:
        version = "" if self._firmware is None else f" (firmware {self._firmware.version})"
        known = " and ".join(map(str, sorted(self._known)))
        return (
            f"the {self._node} node speaks protocol {self._protocol}{version}, needle-rig {VERSION} knows"
            f" {known}; flash the firmware of this version: needle-rig firmware build"
        )
