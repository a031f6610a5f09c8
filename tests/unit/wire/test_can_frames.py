import math
import random
from pathlib import Path

import pytest
from crccheck.crc import Crc8SaeJ1850
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.config.files import find_config_file
from needle_rig.errors import BadInput
from needle_rig.records import STOP, Command, DriveFault, DriveState
from needle_rig.units import nmm, rad
from needle_rig.wire.can_frames import (
    CALIBRATION_IDS,
    DRIVE_COMMAND_ID,
    DRIVE_HEALTH_ID,
    DRIVE_REFERENCE_ID,
    DRIVE_STATUS_ID,
    FIRMWARE_IDS,
    TORQUE_STATUS_ID,
    CanCodec,
    DriveCommand,
    DriveHealth,
    DriveReference,
    DriveStatus,
    NodeCalibration,
    NodeFirmware,
    TorqueStatus,
    checksum,
)

CODEC = CanCodec(find_config_file("needle_rig.dbc"))
counters = st.integers(0, 1000)
clocks = st.floats(0, 1e6)


@given(st.floats(-0.0799, 0.0799), st.integers(0, 15), counters, clocks)
def test_torque_survives_the_wire_to_half_a_step(
    torque_nm: float, state: int, counter: int, time_s: float
) -> None:
    status = CODEC.decode(TORQUE_STATUS_ID, CODEC.encode_torque(torque_nm, state, counter, time_s))
    assert isinstance(status, TorqueStatus)
    assert abs(nmm(status.torque_nm) - nmm(torque_nm)) <= 0.5e-5 + 1e-12
    assert (status.state, status.counter) == (state, counter % 16)
    gap_s = math.remainder(status.node_time_s - time_s, CODEC.torque_clock_period_s)
    assert abs(gap_s) <= 0.51e-5


@given(
    st.floats(-rad(8000), rad(8000)),
    st.sampled_from(DriveState),
    st.integers(0, 255),
    counters,
    clocks,
)
def test_drive_status_survives_the_wire_to_half_a_step(
    angle_rad: float, state: DriveState, faults: int, counter: int, time_s: float
) -> None:
    data = CODEC.encode_drive(angle_rad, state, DriveFault(faults), counter, time_s)
    status = CODEC.decode(DRIVE_STATUS_ID, data)
    assert isinstance(status, DriveStatus)
    assert abs(status.angle_rad - angle_rad) <= rad(0.00051)
    assert (status.state, int(status.faults), status.counter) == (state, faults, counter % 16)
    assert abs(math.remainder(status.node_time_s - time_s, CODEC.drive_clock_period_s)) <= 0.51e-4


@given(st.floats(-rad(800), rad(800)), st.booleans(), st.booleans(), counters, st.integers(0, 10**6))
def test_commands_survive_the_wire(
    velocity_rad_s: float, enable: bool, clear: bool, counter: int, heartbeat: int
) -> None:
    data = CODEC.encode_command(Command(velocity_rad_s, enable, clear), counter, heartbeat)
    content = CODEC.decode(DRIVE_COMMAND_ID, data)
    assert isinstance(content, DriveCommand)
    assert abs(content.command.velocity_rad_s - velocity_rad_s) <= rad(0.000051)
    assert (content.command.enable, content.command.clear) == (enable, clear)
    assert (content.counter, content.heartbeat) == (counter % 16, heartbeat % 65536)


@given(
    st.integers(0, 255),
    st.booleans(),
    st.booleans(),
    st.booleans(),
    st.one_of(st.just(math.nan), st.floats(-rad(8000), rad(8000))),
    st.integers(0, 10**6),
    counters,
)
def test_health_survives_the_wire(
    faults: int, supply: bool, stop: bool, referenced: bool, index_rad: float, uptime_s: int, counter: int
) -> None:
    said = DriveHealth(DriveFault(faults << 8), supply, stop, referenced, index_rad, uptime_s, counter)
    health = CODEC.decode(DRIVE_HEALTH_ID, CODEC.encode_health(said))
    assert isinstance(health, DriveHealth)
    assert (health.faults, health.supply_on, health.emergency_stop) == (said.faults, supply, stop)
    assert (health.referenced, health.counter) == (referenced, counter % 16)
    assert health.uptime_s == min(uptime_s, 65_535)
    assert math.isnan(health.index_rad) == math.isnan(index_rad)
    assert math.isnan(index_rad) or abs(health.index_rad - index_rad) <= rad(0.00051)


def test_status_and_health_share_the_faults() -> None:
    faults = DriveFault.TORQUE_TRIP | DriveFault.EMERGENCY_STOP
    status = CODEC.decode(DRIVE_STATUS_ID, CODEC.encode_drive(0.0, DriveState.FAULT, faults, 1, 0.0))
    said = DriveHealth(faults, False, True, False, math.nan, 1, 1)
    health = CODEC.decode(DRIVE_HEALTH_ID, CODEC.encode_health(said))
    assert isinstance(status, DriveStatus)
    assert isinstance(health, DriveHealth)
    assert (status.faults, health.faults) == (DriveFault.TORQUE_TRIP, DriveFault.EMERGENCY_STOP)


@given(st.floats(-rad(8000), rad(8000)), counters, st.integers(0, 10**6))
def test_references_survive_the_wire(angle_rad: float, counter: int, heartbeat: int) -> None:
    data = CODEC.encode_reference(angle_rad, counter, heartbeat)
    reference = CODEC.decode(DRIVE_REFERENCE_ID, data)
    assert isinstance(reference, DriveReference)
    assert abs(reference.angle_rad - angle_rad) <= rad(0.00051)
    assert (reference.counter, reference.heartbeat) == (counter % 16, heartbeat % 65536)


nodes = st.sampled_from(["torque", "drive"])
versions = st.tuples(st.integers(0, 63), st.integers(0, 255), st.integers(0, 63))


@given(nodes, st.integers(0, 255), versions, st.integers(0, 2**24 - 1), counters)
def test_what_a_node_is_survives_the_wire(
    node: str, protocol: int, version: tuple[int, int, int], build: int, counter: int
) -> None:
    said = NodeFirmware(node, protocol, ".".join(map(str, version)), build, counter)
    data = CODEC.encode_firmware(said)
    assert CODEC.decode(FIRMWARE_IDS[node], data) == said._replace(counter=counter % 16)
    assert data[0] == protocol, "in every protocol the first byte"


@given(nodes, st.integers(0, 255), st.one_of(st.none(), st.integers(0, 2**32 - 1)), counters)
def test_what_a_node_calibrates_with_survives_the_wire(
    node: str, protocol: int, serial: int | None, counter: int
) -> None:
    said = NodeCalibration(node, protocol, serial, counter)
    data = CODEC.encode_calibration(said)
    assert CODEC.decode(CALIBRATION_IDS[node], data) == said._replace(counter=counter % 16)
    assert data[0] == protocol


def test_both_nodes_say_it_in_one_layout() -> None:
    """The C of both packs the torque node's frames."""
    for ids in (FIRMWARE_IDS, CALIBRATION_IDS):
        assert CODEC._layouts[ids["torque"]]._fields == CODEC._layouts[ids["drive"]]._fields


@pytest.mark.parametrize("velocity", [math.nan, math.inf, -math.inf])
def test_a_velocity_that_is_not_finite_stops(velocity: float) -> None:
    content = CODEC.decode(DRIVE_COMMAND_ID, CODEC.encode_command(Command(velocity, True), 1, 1))
    assert isinstance(content, DriveCommand)
    assert content.command == STOP


@pytest.mark.parametrize(("torque_nm", "carried_nmm"), [(1.0, 80.0), (-1.0, -80.0)])
def test_a_torque_beyond_the_signal_is_clipped(torque_nm: float, carried_nmm: float) -> None:
    status = CODEC.decode(TORQUE_STATUS_ID, CODEC.encode_torque(torque_nm, 2, 0, 0.0))
    assert isinstance(status, TorqueStatus)
    assert nmm(status.torque_nm) == pytest.approx(carried_nmm)


@given(st.integers(0, 0x7FF), st.binary(min_size=8, max_size=8))
def test_the_checksum_is_the_one_in_the_dbc(frame_id: int, data: bytes) -> None:
    assert checksum(frame_id, data) == Crc8SaeJ1850.calc(frame_id.to_bytes(2, "little") + data[:7])


@given(st.integers(0, 0x7FF), st.binary(max_size=12))
def test_nothing_with_a_wrong_checksum_or_length_is_taken(frame_id: int, data: bytes) -> None:
    if CODEC.decode(frame_id, data) is not None:
        assert frame_id in (257, 272, 273, 274, 275, 288, 289, 296, 297)
        assert len(data) == 8
        assert data[7] == Crc8SaeJ1850.calc(frame_id.to_bytes(2, "little") + data[:7])


def test_every_damage_of_one_or_two_bits_is_seen() -> None:
    good = int.from_bytes(CODEC.encode_torque(-1.2e-4, 0, 5, 12.3), "big")
    for first in range(64):
        for second in range(first, 64):
            bad = good ^ (1 << first) ^ (1 << second) if first != second else good ^ (1 << first)
            assert CODEC.decode(TORQUE_STATUS_ID, bad.to_bytes(8, "big")) is None


def test_a_frame_under_another_id_is_refused() -> None:
    data = CODEC.encode_torque(1e-4, 0, 5, 12.3)
    assert CODEC.decode(DRIVE_STATUS_ID, data) is None
    assert CODEC.decode(TORQUE_STATUS_ID + 1, data) is None


def test_random_frames_pass_only_as_often_as_eight_bits_allow() -> None:
    source = random.Random(7)
    taken = sum(CODEC.decode(TORQUE_STATUS_ID, source.randbytes(8)) is not None for _ in range(20_000))
    assert taken < 20_000 / 256 * 1.5


def test_a_file_that_is_not_the_dbc_is_refused_in_a_sentence(tmp_path: Path) -> None:
    other = tmp_path / "other.dbc"
    other.write_text('VERSION ""\nBU_: A\nBO_ 1 X: 8 A\n SG_ y : 0|8@1+ (1,0) [0|1] "" A\n')
    with pytest.raises(BadInput, match=r"other\.dbc: not the DBC of a needle rig"):
        CanCodec(other)
    with pytest.raises(BadInput, match="missing"):
        CanCodec(tmp_path / "missing.dbc")


def test_moved_frame_ids_are_refused(tmp_path: Path) -> None:
    text = find_config_file("needle_rig.dbc").read_text().replace("257", "259")
    (tmp_path / "moved.dbc").write_text(text)
    with pytest.raises(BadInput, match="frame ids"):
        CanCodec(tmp_path / "moved.dbc")


def check_mutants(count: int, seed: int) -> None:
    """Damage frames at random; what is still taken must have the right CRC by another program."""
    source = random.Random(seed)
    good = CODEC.encode_command(Command(0.3, enable=True), 7, 1234)
    for _ in range(count):
        bad = bytearray(good)
        for _ in range(source.randint(1, 5)):
            bad[source.randrange(8)] = source.randrange(256)
        if CODEC.decode(DRIVE_COMMAND_ID, bytes(bad)) is not None:
            frame = DRIVE_COMMAND_ID.to_bytes(2, "little") + bytes(bad[:7])
            assert Crc8SaeJ1850.calc(frame) == bad[7]


def test_mutated_commands_with_a_wrong_checksum_are_never_taken() -> None:
    check_mutants(20_000, seed=3)


@pytest.mark.slow
def test_a_million_mutated_commands() -> None:
    check_mutants(1_000_000, seed=4)
