"""The nodes on the CAN bus say what they are: version, build, protocol and calibration page."""

from __future__ import annotations

import datetime
import shutil
from pathlib import Path

import pytest

from needle_rig.config.files import find_config_file
from needle_rig.firmware.host import HostNode, HostNodes
from needle_rig.firmware.pages import drive_page, torque_page
from needle_rig.firmware.pins import PAGE_SIZE, Pins
from needle_rig.firmware.sources import firmware_folder, source_build
from needle_rig.version import VERSION
from needle_rig.wire.can_frames import (
    CALIBRATION_IDS,
    FIRMWARE_IDS,
    CanCodec,
    NodeCalibration,
    NodeFirmware,
)

DAY = datetime.date(2026, 11, 28)
LARGEST_SERIAL = 2**32 - 1
PAGES = {
    "torque": torque_page(0.0, 1e-5, LARGEST_SERIAL, DAY),
    "drive": drive_page(360_000, LARGEST_SERIAL, DAY),
}
NODES = tuple(PAGES)


@pytest.fixture(scope="module")
def codec() -> CanCodec:
    return CanCodec(find_config_file("needle_rig.dbc"))


def said(
    nodes: HostNodes, codec: CanCodec, node: str, page: bytes, boot_us: int = 0, ms: int = 2001
) -> list[tuple[int, NodeFirmware | NodeCalibration]]:
    """What a node that booted at `boot_us` says of itself, each with the millisecond."""
    board = HostNode(nodes, node, Pins(page=page, load_cell=1, time_us=boot_us))
    found = []
    for at_ms in range(ms):
        board.pins.time_us = boot_us + at_ms * 1000
        assert board.poll()
        sent = board.pins.take_can()
        contents = [codec.decode(*frame) for frame in sent]
        assert None not in contents
        own = [each for each in contents if isinstance(each, NodeFirmware | NodeCalibration)]
        assert not own or sent[-1][0] in (FIRMWARE_IDS[node], CALIBRATION_IDS[node]), "status goes first"
        found += [(at_ms, each) for each in own]
    return found


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("boot_us", [0, 2**32 - 700_000])
def test_a_node_says_what_it_is_at_boot_and_then_once_a_second(
    nodes: HostNodes, codec: CanCodec, node: str, boot_us: int
) -> None:
    """The second node's clock wraps meanwhile."""
    build = source_build(firmware_folder())
    (protocol,) = codec.protocols
    assert said(nodes, codec, node, PAGES[node], boot_us) == [
        (0, NodeFirmware(node, protocol, VERSION, build, 0)),
        (500, NodeCalibration(node, protocol, LARGEST_SERIAL, 0)),
        (1000, NodeFirmware(node, protocol, VERSION, build, 1)),
        (1500, NodeCalibration(node, protocol, LARGEST_SERIAL, 1)),
        (2000, NodeFirmware(node, protocol, VERSION, build, 2)),
    ]


@pytest.mark.parametrize("node", NODES)
def test_a_blank_or_damaged_page_has_no_serial_number(nodes: HostNodes, codec: CanCodec, node: str) -> None:
    damaged = bytearray(PAGES[node])
    damaged[16] ^= 1
    for page in (b"\xff" * PAGE_SIZE, bytes(damaged)):
        (_, calibration) = said(nodes, codec, node, page, ms=501)[-1]
        assert isinstance(calibration, NodeCalibration)
        assert calibration.serial is None


def test_a_page_that_the_drive_cannot_use_is_not_told(nodes: HostNodes, codec: CanCodec) -> None:
    (_, calibration) = said(nodes, codec, "drive", drive_page(0, 9, DAY), ms=501)[-1]
    assert isinstance(calibration, NodeCalibration)
    assert calibration.serial is None


def test_the_build_follows_the_sources_alone(tmp_path: Path) -> None:
    copy = tmp_path / "elsewhere"
    shutil.copytree(firmware_folder(), copy)
    build = source_build(copy)
    assert build == source_build(firmware_folder())
    assert 0 < build < 2**24
    (copy / "README.md").write_text("other words")
    assert source_build(copy) == build
    guard = copy / "core" / "nr_guard.c"
    guard.write_bytes(guard.read_bytes() + b"\n")
    assert source_build(copy) != build
