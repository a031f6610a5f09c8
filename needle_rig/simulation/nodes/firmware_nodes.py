"""The three nodes as the firmware's own C code, in the place of the nodes in Python.

Counts in, frames out, at the node's own clock in µs: each node is the host library or the Cortex-M image
under its emulator, behind the pins of its board.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.firmware.cache import built_firmware
from needle_rig.firmware.emulator import ImageNode
from needle_rig.firmware.host import HostNode, HostNodes
from needle_rig.firmware.pages import read_page
from needle_rig.firmware.pins import PAGE_SIZE, Pins
from needle_rig.records import DriveFault, DriveState
from needle_rig.simulation.nodes.analogue import AnalogueFrontEnd
from needle_rig.simulation.nodes.slcan_hub import Frame
from needle_rig.wire.can_frames import DRIVE_HEALTH_ID, DRIVE_STATUS_ID

BLANK = b"\xff" * PAGE_SIZE
_LOOKS = 1000


class Node(Protocol):
    """One node, however it runs."""

    pins: Pins

    def poll(self) -> bool:
        """One turn of its main loop; True when it ticked."""


class FirmwareNodes:
    """Makes nodes of one build: the host library, or with `image` the Cortex-M images.

    `pages` is a folder with the calibration pages that were flashed (`hall.hex`, `torque.hex`, `drive.hex`);
    nodes without one are blank. Raises BadInput when the firmware cannot be built.
    """

    def __init__(self, *, image: bool = False, pages: Path | None = None, build: Path | None = None) -> None:
        self._folder = build or built_firmware(images=image)
        self._host = None if image else HostNodes(self._folder)
        if pages is not None and not pages.is_dir():
            raise BadInput(f"{pages}: no folder of calibration pages; make one: needle-rig calibrate")
        self._pages = pages

    def make(self, kind: str, boot_us: int = 0) -> Node:
        """A node of `kind` (torque, hall, drive) that has just booted, its clock at `boot_us`."""
        page = BLANK
        if self._pages is not None and (self._pages / f"{kind}.hex").exists():
            page = read_page(self._pages / f"{kind}.hex")
        pins = Pins(page=page, time_us=boot_us)
        if self._host is None:
            return ImageNode(self._folder / f"{kind}.elf", pins)
        return HostNode(self._host, kind, pins)


class TorqueFirmware:
    """The torque node, its converter fed with counts."""

    def __init__(self, nodes: FirmwareNodes) -> None:
        self.node = nodes.make("torque")

    def step(self, now_us: int, torque_counts: int) -> tuple[Frame, ...]:
        """The frames of one sample."""
        pins = self.node.pins
        pins.time_us, pins.load_cell = now_us, torque_counts
        _tick(self.node)
        return tuple(pins.take_can())


class HallFirmware:
    """The Hall node, its analogue inputs fed with counts."""

    def __init__(self, nodes: FirmwareNodes) -> None:
        self.node = nodes.make("hall")

    def step(self, now_us: int, pairs: Sequence[tuple[int, int]]) -> bytes:
        """The bytes of one sample."""
        pins = self.node.pins
        pins.time_us = now_us
        for i, counts in enumerate(count for pair in pairs for count in pair):
            pins.adc[i] = counts
        _tick(self.node)
        return pins.take_uart()


class DriveFirmware:
    """The drive node: frames, encoder and safety inputs in, duty of the motor's bridge and its supply out."""

    def __init__(self, nodes: FirmwareNodes, boot_us: int = 0) -> None:
        self._nodes = nodes
        self.reset(boot_us)

    def reset(self, now_us: int) -> None:
        """The node restarts: silent, its counts from zero."""
        self.node = self._nodes.make("drive", now_us)
        self.state = DriveState.SILENT
        self.faults = DriveFault.NONE

    @property
    def supply_on(self) -> bool:
        """Whether the bridge may have its supply."""
        return self.node.pins.supply

    @property
    def powered(self) -> bool:
        """Whether the bridge drives the motor."""
        return AnalogueFrontEnd.velocity_rad_s(self.node.pins.duty) != 0.0

    def receive(self, _now_us: int, frame_id: int, data: bytes) -> None:
        """A frame seen on the bus: it waits in the controller until the node looks."""
        self.node.pins.can_in.append((frame_id, data))

    def step(
        self, now_us: int, encoder_counts: int, *, index: bool = False, emergency_stop: bool = False
    ) -> tuple[tuple[Frame, ...], float]:
        """The frames of one sample, and the velocity in rad/s that the bridge asks of the motor."""
        pins = self.node.pins
        pins.time_us, pins.encoder_counts = now_us, encoder_counts
        pins.index, pins.emergency_stop = index, emergency_stop
        _tick(self.node)
        frames = tuple(pins.take_can())
        for frame_id, data in frames:
            if frame_id == DRIVE_HEALTH_ID:
                self.faults = DriveFault(self.faults & 0xFF | data[0] << 8)
            elif frame_id == DRIVE_STATUS_ID:
                self.state = DriveState(data[3] & 3)
                self.faults = DriveFault(self.faults & ~0xFF | data[4])
        return frames, AnalogueFrontEnd.velocity_rad_s(pins.duty)


def _tick(node: Node) -> None:
    # A node that is polled a moment too early ticks at a later look at its clock.
    for _ in range(_LOOKS):
        if node.poll():
            return
        node.pins.time_us += 1
    raise NeedleRigError("firmware: a node did not tick within its period; its clock went backwards")
