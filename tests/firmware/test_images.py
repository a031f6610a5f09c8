"""The Cortex-M images: small, built the same everywhere, and saying what the host library says."""

from __future__ import annotations

import math
import random
import shutil
from pathlib import Path

import pytest

from needle_rig.config.files import find_config_file
from needle_rig.errors import NeedleRigError
from needle_rig.firmware.build import Image, build, sizes
from needle_rig.firmware.emulator import ADC_SR, FLASH, ImageNode
from needle_rig.firmware.host import HostNode, HostNodes
from needle_rig.firmware.measure import CORE_HZ, measure
from needle_rig.firmware.pins import Pins
from needle_rig.firmware.sources import NODES, firmware_folder
from needle_rig.records import Command
from needle_rig.wire.can_frames import DRIVE_COMMAND_ID, TORQUE_STATUS_ID, CanCodec

FLASH_LIMIT, RAM_LIMIT = 16 * 1024, 4 * 1024


def bridge(pins: Pins) -> int:
    """The duty that the board's 12-bit bridge makes of the node's."""
    return int(pins.duty / 8)


def drive_pins(pins: Pins, codec: CanCodec, ms: int) -> None:
    """A host that clears, then turns back and forth; a shaft that follows the bridge."""
    pins.time_us = ms * 1000
    if ms % 5 == 0:
        speed = 40 * math.sin(ms / 300)
        command = Command(clear=True) if 20 < ms < 60 else Command(math.radians(speed), enable=ms > 60)
        pins.can_in.append((DRIVE_COMMAND_ID, codec.encode_command(command, ms // 5, ms // 5)))
    if ms % 97:
        pins.can_in.append((TORQUE_STATUS_ID, codec.encode_torque(1e-4, 0, ms, ms * 1e-3)))
    pins.encoder_counts += round(bridge(pins) / 4096 * 180)
    pins.index = 0 <= pins.encoder_counts % 3000 < 500
    pins.emergency_stop = ms > 550


def supplied(ms: int) -> bool:
    """Between the clear and the emergency stop of `drive_pins`."""
    return 25 <= ms <= 550


@pytest.mark.parametrize("kind", NODES)
def test_image_and_host_library_give_the_same_bytes(built: Path, nodes: HostNodes, kind: str) -> None:
    codec = CanCodec(find_config_file("needle_rig.dbc"))
    rng = random.Random(3)
    pins = (Pins(), Pins())
    pair = (HostNode(nodes, kind, pins[0]), ImageNode(built / f"{kind}.elf", pins[1]))
    for ms in range(1, 600):
        counts = rng.choice((None, rng.randint(-(2**23), 2**23 - 1), 1000 * ms))
        adc = [rng.randrange(4096) for _ in range(8)]
        for p in pins:
            p.time_us, p.load_cell, p.adc = ms * 1000, counts, adc
            if kind == "drive":
                drive_pins(p, codec, ms)
        assert pair[0].poll()
        assert pair[1].poll()
        assert pins[0].take_can() == pins[1].take_can()
        assert pins[0].take_uart() == pins[1].take_uart()
        assert bridge(pins[0]) == bridge(pins[1])
        assert pins[0].supply == pins[1].supply == (kind == "drive" and supplied(ms))
    if kind == "drive":
        assert abs(pins[0].encoder_counts) > 100


def test_an_image_that_hangs_or_faults_is_told(built: Path) -> None:
    node = ImageNode(built / "hall.elf", Pins(time_us=1000))
    assert node.poll()
    assert not node.poll(), "the clock stands still: nothing is due"
    node._registers[ADC_SR] = 0
    node.pins.time_us += 1000
    with pytest.raises(NeedleRigError, match="hangs at its register 0x40012000"):
        node.poll()
    node = ImageNode(built / "hall.elf", Pins(time_us=1000))
    vectors = bytes(node.emulator.mem_read(FLASH, 16))
    node._at = int.from_bytes(vectors[12:], "little")
    with pytest.raises(NeedleRigError, match="fault handler"):
        node.poll()


@pytest.mark.parametrize("kind", NODES)
def test_images_are_small_and_quick(built: Path, kind: str) -> None:
    text, data, bss = sizes(built / f"{kind}.elf")
    load = measure(
        Image(kind, built / f"{kind}.elf", text, data, bss), CanCodec(find_config_file("needle_rig.dbc"))
    )
    assert text + data < FLASH_LIMIT
    assert load.stack > 0
    assert data + bss + load.stack < RAM_LIMIT
    # A tick is a millisecond; a fifth of it, at two cycles an instruction.
    assert 100 < load.instructions < CORE_HZ // 1000 // 5 // 2


@pytest.mark.whole
def test_builds_are_the_same_from_any_folder(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "elsewhere" / "firmware"
    shutil.copytree(firmware_folder(), copy)
    monkeypatch.setattr("needle_rig.firmware.build.firmware_folder", lambda: copy)
    build(tmp_path / "out")
    for name in sorted(path.name for path in built.iterdir()):
        assert (tmp_path / "out" / name).read_bytes() == (built / name).read_bytes(), name
