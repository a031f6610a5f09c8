"""Hall, torque and drive: calibration, filter and loop of the nodes, through the host library."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from datetime import date
from typing import Any

import numpy as np
import pytest

from needle_rig.config.files import find_config_file
from needle_rig.firmware.host import HostNode, HostNodes
from needle_rig.firmware.pages import drive_page
from needle_rig.firmware.pins import Pins
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.wire.can_frames import DRIVE_COMMAND_ID, TORQUE_STATUS_ID, CanCodec, TorqueStatus

MOST_MOVED, MOST_VELOCITY = (2**63 - 1) // 1_000_000, (2**63 - 1) // 512
"""What the drive node's arithmetic saturates at, 1e-4 deg and 1e-4 deg/s."""


@pytest.fixture(scope="module")
def codec() -> CanCodec:
    return CanCodec(find_config_file("needle_rig.dbc"))


def torque_of(codec: CanCodec, node: HostNode) -> TorqueStatus:
    (frame_id, data), *_ = node.pins.take_can()
    status = codec.decode(frame_id, data)
    assert isinstance(status, TorqueStatus)
    return status


def test_torque_filter_has_the_stated_bandwidth_and_delay(nodes: HostNodes, codec: CanCodec) -> None:
    def gain(frequency_hz: float) -> float:
        node = HostNode(nodes, "torque", Pins())
        out = []
        for ms in range(2000):
            node.pins.time_us = ms * 1000
            node.pins.load_cell = round(1e6 * math.sin(math.tau * frequency_hz * ms * 1e-3)) + ms % 2
            node.poll()
            out.append(torque_of(codec, node).torque_nm)
        return (max(out[1000:]) - min(out[1000:])) / 2e-2

    assert gain(46.0) == pytest.approx(math.sqrt(0.5), abs=0.02)
    assert gain(1.0) == pytest.approx(1.0, abs=0.002)


def test_torque_states(nodes: HostNodes, codec: CanCodec) -> None:
    node = HostNode(nodes, "torque", Pins(load_cell=100))

    def run(ticks: int, counts: Callable[[int], int | None]) -> int:
        state = -1
        for i in range(ticks):
            node.pins.time_us += 1000
            node.pins.load_cell = counts(i)
            node.poll()
            state = torque_of(codec, node).state
        return state

    assert run(30, lambda i: i) == 1
    assert run(10, lambda i: i) == 0
    assert run(5, lambda _: None) == 3
    assert run(5, lambda i: i) == 0
    assert run(3, lambda _: 2**23 - 1) == 2
    assert run(3, lambda _: -(2**23)) == 2
    assert run(990, lambda _: 77) == 0
    assert run(20, lambda _: 77) == 3, "a converter that repeats itself for a second is stuck"
    assert run(5, lambda i: i) == 0


@pytest.fixture
def drive(nodes: HostNodes, codec: CanCodec) -> Drive:
    return Drive(nodes, codec)


class Drive:
    """The drive node with a motor: duty to speed with a lag, speed to encoder counts."""

    def __init__(self, nodes: HostNodes, codec: CanCodec, *, gain: float = 1.0, lag_s: float = 0.02) -> None:
        self.node = HostNode(nodes, "drive", Pins())
        self.codec = codec
        self.gain, self.lag_s = gain, lag_s
        self.rate_deg_s = 0.0
        self.angle_deg = 0.0
        self.ms = 0
        self.command = Command()

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.ms += 1
            pins = self.node.pins
            pins.time_us = self.ms * 1000
            if self.ms % 5 == 0:
                data = self.codec.encode_command(self.command, self.ms // 5, self.ms // 5)
                pins.can_in.append((DRIVE_COMMAND_ID, data))
            torque = self.codec.encode_torque(0.0, 0, self.ms, self.ms * 1e-3)
            pins.can_in.append((TORQUE_STATUS_ID, torque))
            # full duty turns at 180 deg/s
            wanted = self.gain * pins.duty / 32768 * 180
            self.rate_deg_s += (wanted - self.rate_deg_s) * 1e-3 / self.lag_s
            self.angle_deg += self.rate_deg_s * 1e-3
            pins.encoder_counts = math.floor(self.angle_deg * 1000)
            self.node.poll()
            pins.take_can()

    @property
    def state(self) -> DriveState:
        return DriveState(self.node.app.node.guard.state)

    def start(self) -> Drive:
        self.run(20)
        self.command = Command(clear=True)
        self.run(20)
        assert self.state is DriveState.READY
        return self


@pytest.mark.parametrize("gain", [0.7, 1.0, 1.3])
@pytest.mark.parametrize("speed_deg_s", [-80.0, -45.0, -1.0, 0.5, 10.0, 80.0])
def test_drive_turns_at_the_commanded_speed(
    nodes: HostNodes, codec: CanCodec, gain: float, speed_deg_s: float
) -> None:
    drive = Drive(nodes, codec, gain=gain).start()
    drive.command = Command(math.radians(speed_deg_s), enable=True)
    drive.run(1000)
    start_deg = drive.angle_deg
    drive.run(1000)
    assert drive.angle_deg - start_deg == pytest.approx(speed_deg_s, rel=0.01, abs=0.02)
    assert DriveFault(drive.node.app.node.guard.faults) == DriveFault.NONE


def test_drive_ramps(drive: Drive) -> None:
    drive.start()
    drive.command = Command(math.radians(60), enable=True)
    rates = []
    for _ in range(120):
        drive.run(1)
        rates.append(drive.rate_deg_s)
    rise = np.diff(rates) * 1000
    assert rise.max() <= 720 * 1.35
    assert max(rates) <= 60 * 1.1


def test_bridge_is_off_unless_running(drive: Drive) -> None:
    drive.run(100)
    assert drive.node.pins.duty == 0
    drive.start()
    drive.command = Command(math.radians(45), enable=True)
    drive.run(200)
    assert drive.node.pins.duty != 0
    drive.command = Command()
    drive.run(6)
    assert drive.node.pins.duty == 0


def page(magic: int, content: bytes, serial: int = 7, date: int = 20260101) -> bytes:
    import binascii

    head = struct.pack("<IIIHH", magic, serial, date, len(content), binascii.crc_hqx(content, 0xFFFF))
    return (head + content).ljust(256, b"\xff")


def test_torque_calibration_page(nodes: HostNodes, codec: CanCodec) -> None:
    content = struct.pack("<ii", 12_345, round(0.25 * 2**24))
    for good in (True, False):
        sealed = bytearray(page(0x31515254, content))
        sealed[17] ^= 0 if good else 1
        node = HostNode(nodes, "torque", Pins(load_cell=112_345, page=bytes(sealed)))
        node.poll()
        assert node.app.node.identity.calibrated == good
        expected = 100_000 * 0.25 if good else 112_345
        assert torque_of(codec, node).torque_nm == pytest.approx(expected * 1e-8, abs=2e-8)


def test_hall_calibration_page_takes_out_what_a_sensor_does_wrong(nodes: HostNodes) -> None:
    sine_offset, cosine_offset, sine_gain, zero, h1, phase1 = 2100.0, 1990.0, 0.9, 0.4, 0.03, 1.0
    one = struct.pack(
        "<9i",
        round(sine_offset * 256),
        round(cosine_offset * 256),
        round(2**14 / sine_gain),
        2**14,
        round(zero * 1e6),
        round(h1 * 1e6),
        0,
        round(phase1 * 1e6),
        0,
    )
    pins = Pins(page=page(0x314C4148, one * 4))
    node = HostNode(nodes, "hall", pins)
    assert node.app.node.calibrated
    calibration = nodes.ffi.addressof(node.app.node, "calibration")[0]
    field = nodes.ffi.new("uint16_t *")
    for raw in np.linspace(-math.pi, math.pi, 361):
        pair = {
            "sine": round(sine_offset + 1500 * sine_gain * math.sin(raw)),
            "cosine": round(cosine_offset + 1500 * math.cos(raw)),
        }
        angle = nodes.lib.nr_hall_angle_urad(nodes.ffi.addressof(calibration[0]), pair, field) * 1e-6
        expected = raw - zero - h1 * math.sin(raw + phase1)
        assert abs(math.remainder(angle - expected, math.tau)) < 6e-4
        assert field[0] == pytest.approx(16 * 1500, rel=2e-3)


@pytest.mark.parametrize("turns", [1, -1])
@pytest.mark.parametrize("jump_counts", [2**20, 2**24, 2**30, 2**31 - 1, -(2**31 - 1)])
@pytest.mark.parametrize("elapsed_us", [1, 1000])
def test_counts_that_jump_with_one_count_a_turn_are_a_velocity_of_the_right_sign(
    nodes: HostNodes, turns: int, jump_counts: int, elapsed_us: int
) -> None:
    node: Any = nodes.ffi.new("struct nr_drive_node *")
    page = nodes.ffi.new("uint8_t[]", drive_page(turns, 1, date(2026, 1, 1)))
    nodes.lib.nr_drive_init(node, nodes.ffi.addressof(nodes.lib.nr_drive_defaults), page)
    outputs, inputs = nodes.ffi.new("struct nr_drive_outputs *"), nodes.ffi.new("struct nr_drive_inputs *")
    inputs.encoder_good = True
    nodes.lib.nr_drive_tick(node, 1_000_000, inputs, outputs)
    expected = 0
    for k in range(1, 6):
        inputs.counts = jump_counts if k % 2 else 0
        nodes.lib.nr_drive_tick(node, 1_000_000 + k * elapsed_us, inputs, outputs)
        moved = (jump_counts if k % 2 else -jump_counts) * turns
        units = max(-MOST_MOVED, min(moved * 3_600_000, MOST_MOVED))
        velocity = max(-MOST_VELOCITY, min(int(units * 1_000_000 / elapsed_us), MOST_VELOCITY))
        expected += int((velocity * 256 - expected) / 4)
        assert node.velocity_q8 == pytest.approx(expected, rel=1e-9)
        assert outputs.duty == 0
