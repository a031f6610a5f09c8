"""Python and C speak the same bytes: whatever one encodes the other decodes, and damage is seen by both."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from needle_rig.config.files import find_config_file
from needle_rig.firmware.host import HostNode, HostNodes
from needle_rig.firmware.pins import Pins
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.wire.can_frames import (
    DRIVE_COMMAND_ID,
    DRIVE_STATUS_ID,
    TORQUE_STATUS_ID,
    CanCodec,
    DriveStatus,
    TorqueStatus,
    checksum,
)
from needle_rig.wire.hall_frames import cobs_decode, cobs_encode, decode_hall, encode_hall

CONTENT = st.binary(min_size=1, max_size=64)


@pytest.fixture(scope="module")
def codec() -> CanCodec:
    return CanCodec(find_config_file("needle_rig.dbc"))


def c_encode(nodes: HostNodes, content: bytes) -> bytes:
    out = nodes.ffi.new("uint8_t[68]")
    return bytes(out[0 : nodes.lib.nr_frame_encode(content, len(content), out, 68)])


def c_decode(nodes: HostNodes, frame: bytes) -> bytes:
    out = nodes.ffi.new("uint8_t[64]")
    return bytes(out[0 : nodes.lib.nr_frame_decode(frame, len(frame), out, 64)])


def sealed(content: bytes) -> bytes:
    import binascii

    return cobs_encode(content + binascii.crc_hqx(content, 0xFFFF).to_bytes(2, "little"))


@given(CONTENT)
@example(bytes(64))
@example(bytes(range(1, 65)))
def test_serial_frames_agree(nodes: HostNodes, content: bytes) -> None:
    assert c_encode(nodes, content) == sealed(content) + b"\0"
    assert c_decode(nodes, sealed(content)) == content
    decoded = cobs_decode(c_encode(nodes, content)[:-1])
    assert decoded is not None
    assert decoded[:-2] == content


@given(st.integers(65, 200), st.integers(0, 67))
def test_serial_frames_that_do_not_fit_are_refused(nodes: HostNodes, length: int, room: int) -> None:
    out = nodes.ffi.new("uint8_t[300]")
    assert nodes.lib.nr_frame_encode(bytes(length), length, out, 300) == 0
    short = bytes(max(1, min(room, 64)))
    assert nodes.lib.nr_frame_encode(short, len(short), out, len(short) + 3) == 0
    whole = sealed(b"abcdef")
    assert nodes.lib.nr_frame_decode(whole, len(whole), out, 5) == 0


@given(st.binary(max_size=80))
def test_serial_decoders_agree_on_garbage(nodes: HostNodes, frame: bytes) -> None:
    sealed_content = cobs_decode(frame)
    good = (
        sealed_content is not None
        and 3 <= len(sealed_content) <= 66
        and sealed(sealed_content[:-2]) == cobs_encode(sealed_content)
    )
    assert bool(c_decode(nodes, frame)) == good


@given(st.integers(0, 2047), st.binary(min_size=8, max_size=8))
def test_checksums_agree(nodes: HostNodes, frame_id: int, data: bytes) -> None:
    assert nodes.lib.nr_can_checksum(frame_id, data) == checksum(frame_id, data)
    assert nodes.lib.nr_can_valid(frame_id, data, 8) == (data[7] == checksum(frame_id, data))
    assert not nodes.lib.nr_can_valid(frame_id, data, 7)


@given(
    st.floats(-89, 89, allow_nan=False),
    st.booleans(),
    st.booleans(),
    st.integers(0, 15),
    st.integers(0, 65535),
)
def test_the_drive_node_reads_the_hosts_commands(
    nodes: HostNodes,
    codec: CanCodec,
    velocity_deg_s: float,
    enable: bool,
    clear: bool,
    counter: int,
    heartbeat: int,
) -> None:
    node = HostNode(nodes, "drive", Pins())
    command = Command(math.radians(velocity_deg_s), enable, clear)
    for step in (0, 1):
        data = codec.encode_command(command, counter + step, heartbeat)
        node.pins.can_in.append((DRIVE_COMMAND_ID, data))
    node.poll()
    seen = node.app.node.guard.command
    assert seen.velocity == round(velocity_deg_s * 1e4)
    assert (seen.enable, seen.clear) == (enable, clear)
    assert seen.counter == (counter + 1) % 16
    assert seen.heartbeat == heartbeat


@given(st.integers(-8_000_000, 8_000_000))
def test_the_host_reads_the_torque_node(nodes: HostNodes, codec: CanCodec, counts: int) -> None:
    node = HostNode(nodes, "torque", Pins(load_cell=counts, time_us=123_456_780))
    node.poll()
    (frame_id, data), *_ = node.pins.take_can()
    status = codec.decode(frame_id, data)
    assert isinstance(status, TorqueStatus)
    assert status.torque_nm == pytest.approx(counts * 1e-8, abs=1e-12)
    assert status.node_time_s == pytest.approx(123.45678)


@given(st.integers(-2_000_000, 2_000_000), st.integers(0, 2**32 - 1))
def test_the_host_reads_the_drive_node(nodes: HostNodes, codec: CanCodec, counts: int, time_us: int) -> None:
    node = HostNode(nodes, "drive", Pins(encoder_counts=5, time_us=time_us))
    node.poll()
    node.pins.take_can()
    node.pins.time_us = time_us + 1000
    node.pins.encoder_counts = 5 + counts
    node.poll()
    ((frame_id, data),) = node.pins.take_can()
    assert frame_id == DRIVE_STATUS_ID
    status = codec.decode(frame_id, data)
    assert isinstance(status, DriveStatus)
    angle_deg = max(-8000.0, min(8000.0, counts * 0.001))
    assert math.degrees(status.angle_rad) == pytest.approx(angle_deg, abs=2e-3)
    assert status.state is DriveState.SILENT
    assert status.faults == DriveFault.NONE


@given(st.lists(st.integers(0, 4095), min_size=8, max_size=8))
def test_the_host_reads_the_hall_node(nodes: HostNodes, adc: list[int]) -> None:
    node = HostNode(nodes, "hall", Pins(adc=adc, time_us=42_000))
    node.poll()
    frame = decode_hall(node.pins.take_uart()[:-1])
    assert frame is not None
    assert frame.node_time_s == pytest.approx(0.042)
    for i, angle in enumerate(frame.angle_rad):
        sine, cosine = adc[2 * i] - 2048, adc[2 * i + 1] - 2048
        if math.hypot(sine, cosine) > 50:
            assert abs(math.remainder(angle - math.atan2(sine, cosine), math.tau)) < 1e-5
    again = decode_hall(encode_hall(frame.counter, 42_000, frame.angle_rad, frame.field)[:-1])
    assert again is not None
    assert (again.counter, again.field) == (frame.counter, frame.field)
    for angle, same in zip(frame.angle_rad, again.angle_rad, strict=True):
        assert abs(math.remainder(angle - same, math.tau)) < 1.1e-6  # half a turn may change its sign


def mutated(rng: random.Random, frame: bytes) -> bytes:
    """`frame` with bits flipped, bytes lost, doubled or replaced; or noise."""
    kind = rng.randrange(5)
    if kind == 0:
        return rng.randbytes(rng.randrange(0, 70))
    changed = bytearray(frame)
    for _ in range(rng.randrange(1, 4)):
        at = rng.randrange(len(changed))
        if kind == 1:
            changed[at] ^= 1 << rng.randrange(8)
        elif kind == 2 and len(changed) > 1:
            del changed[at]
        elif kind == 3:
            changed.insert(at, changed[at])
        else:
            changed[at] = rng.randrange(256)
    return bytes(changed)


def test_a_hundred_thousand_damaged_frames_move_nothing(nodes: HostNodes, codec: CanCodec) -> None:
    rng = random.Random(7)
    node = HostNode(nodes, "drive", Pins())
    guard = node.app.node.guard
    good = codec.encode_command(Command(0.5, enable=True), 3, 9)
    for i in range(100_000):
        data = mutated(rng, good)[:8]
        frame_id = rng.choice((DRIVE_COMMAND_ID, TORQUE_STATUS_ID, DRIVE_STATUS_ID, rng.randrange(2048)))
        if len(data) == 8 and data[7] == checksum(frame_id, data):
            continue
        nodes.lib.nr_drive_receive(nodes.ffi.addressof(node.app.node), i, frame_id, data, len(data))
        assert not guard.sequence_seen
        assert not guard.torque_seen
    assert guard.state == DriveState.SILENT
