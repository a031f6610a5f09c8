"""The drive node stops when in doubt, whatever the doubt; the sensor nodes say what they were given."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.config.files import find_config_file
from needle_rig.config.loader import load_rig_config
from needle_rig.records import STOP, Command, DriveFault, DriveState, Measurement
from needle_rig.simulation.nodes.front_end import HALL_AMPLITUDE_COUNTS, TORQUE_FULL_SCALE, inputs
from needle_rig.simulation.nodes.python_nodes import DriveNode, HallNode, TorqueNode
from needle_rig.units import deg, nm, nmm, rad
from needle_rig.wire.can_frames import (
    DRIVE_COMMAND_ID,
    DRIVE_REFERENCE_ID,
    DRIVE_STATUS_ID,
    TORQUE_STATUS_ID,
    CanCodec,
    DriveStatus,
    TorqueStatus,
)
from needle_rig.wire.hall_frames import HEALTHY_FIELD, decode_hall
from tests.values import now

CODEC = CanCodec(find_config_file("needle_rig.dbc"))
LIMITS = load_rig_config().drive
CLEAR = Command(clear=True, acknowledge=True)
TURN = Command(rad(20), enable=True)


class Host:
    """A drive node with a host that speaks every 5 ms and a torque node every 1 ms."""

    def __init__(self) -> None:
        self.node = DriveNode(CODEC, LIMITS)
        self.now_us = 0
        self.counter = 0
        self.heartbeat = 0
        self.angle_deg = 0.0
        self.torque_nmm = 0.05
        self.torque_goes = True
        self.velocity_rad_s = 0.0

    def command(self, command: Command, *, damage: int = 0, beat: int = 1, step: int = 1) -> None:
        self.counter += step
        self.heartbeat += beat
        data = CODEC.encode_command(command, self.counter, self.heartbeat)
        self.node.receive(self.now_us, DRIVE_COMMAND_ID, bytes((data[0] ^ damage, *data[1:])))

    def pass_ms(self, milliseconds: int, command: Command | None = None, **kind: int) -> None:
        for index in range(milliseconds):
            if command is not None and index % 5 == 0:
                self.command(command, **kind)
            if self.torque_goes:
                torque = CODEC.encode_torque(nm(self.torque_nmm), 0, index, self.now_us * 1e-6)
                self.node.receive(self.now_us, TORQUE_STATUS_ID, torque)
            self.angle_deg += deg(self.velocity_rad_s) * 1e-3
            _, self.velocity_rad_s = self.node.step(self.now_us, round(self.angle_deg * 1000))
            self.now_us += 1000


def running(at_deg: float = 0.0) -> Host:
    """Turning at 20°/s from the place that a reference called `at_deg`."""
    host = Host()
    host.pass_ms(20, STOP)
    host.pass_ms(10, CLEAR)
    host.pass_ms(120, STOP)
    data = CODEC.encode_reference(rad(at_deg), host.counter, host.heartbeat)
    host.node.receive(host.now_us, DRIVE_REFERENCE_ID, data)
    assert host.node.guard.referenced
    host.pass_ms(100, TURN)
    assert host.node.state is DriveState.RUNNING
    assert host.velocity_rad_s == pytest.approx(rad(20), rel=0.15)
    return host


def test_after_boot_nothing_moves_without_a_clear() -> None:
    host = Host()
    host.pass_ms(200, TURN)
    assert host.node.state is DriveState.SILENT
    assert host.velocity_rad_s == 0.0


def test_a_clear_that_asks_for_motion_clears_nothing() -> None:
    host = Host()
    host.pass_ms(50, STOP)
    host.pass_ms(50, Command(rad(20), enable=True, clear=True))
    assert host.node.state is DriveState.SILENT


def test_a_stuck_clear_bit_clears_once() -> None:
    host = running()
    host.pass_ms(5, STOP)
    host.pass_ms(200, CLEAR)
    assert now(host.node.state) is DriveState.READY
    host.torque_nmm = 5.0
    host.pass_ms(5, TURN)
    assert now(host.node.state) is DriveState.FAULT
    host.torque_nmm = 0.0
    host.pass_ms(110, STOP)
    host.pass_ms(5, CLEAR)
    assert now(host.node.state) is DriveState.READY
    host.torque_nmm = 5.0
    host.pass_ms(5, Command(rad(20), enable=True, clear=True))
    host.torque_nmm = 0.0
    host.pass_ms(100, CLEAR)
    assert host.node.state is DriveState.FAULT


def test_it_stops_50_ms_after_the_last_command_and_moves_only_after_a_clear() -> None:
    host = running()
    last_us = host.node.guard.command_us
    while host.velocity_rad_s:
        host.pass_ms(1)
    assert last_us is not None
    assert 50_000 < host.now_us - 1000 - last_us <= 51_000
    assert host.node.faults == DriveFault.COMMAND_AGE
    host.pass_ms(100, TURN)
    assert now(host.node.state) is DriveState.FAULT
    host.pass_ms(5, CLEAR)
    host.pass_ms(30, TURN)
    assert host.node.state is DriveState.RUNNING


def test_a_ready_drive_whose_host_leaves_falls_silent() -> None:
    host = running()
    host.pass_ms(10, STOP)
    host.pass_ms(60)
    assert host.node.state is DriveState.SILENT


@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        ({"damage": 1}, DriveFault.COMMAND_AGE),
        ({"step": 0}, DriveFault.MASTER),
        ({"step": 4}, DriveFault.MASTER),
        ({"beat": 0}, DriveFault.HEARTBEAT),
    ],
)
def test_commands_that_are_not_right_do_not_keep_it_going(kind: dict[str, int], fault: DriveFault) -> None:
    host = running()
    host.pass_ms(70, TURN, **kind)
    assert host.node.state is DriveState.FAULT
    assert fault in host.node.faults


def test_a_few_lost_commands_are_borne() -> None:
    host = running()
    host.counter += 2
    host.pass_ms(60, TURN)
    assert host.node.state is DriveState.RUNNING


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"torque_nmm": 2.01}, DriveFault.TORQUE_TRIP),
        ({"torque_nmm": -2.01}, DriveFault.TORQUE_TRIP),
        ({"torque_goes": False}, DriveFault.TORQUE_AGE),
    ],
)
def test_what_the_node_sees_for_itself_stops_it(change: dict[str, float], fault: DriveFault) -> None:
    host = running()
    for name, value in change.items():
        setattr(host, name, value)
    host.pass_ms(60, TURN)
    assert (host.node.state, host.node.faults) == (DriveState.FAULT, fault)
    assert host.velocity_rad_s == 0.0


def test_a_command_beyond_the_limit_stops_it() -> None:
    host = running()
    host.pass_ms(5, Command(rad(91), enable=True))
    assert host.node.faults == DriveFault.VELOCITY


def test_many_damaged_commands_stop_it_though_good_ones_come_too() -> None:
    host = running()
    for _ in range(12):
        host.command(TURN, damage=3, step=0)
    host.pass_ms(1, TURN)
    assert host.node.faults == DriveFault.FRAME


def test_out_of_range_it_may_turn_back_in_after_a_clear_and_no_further_out() -> None:
    host = running(at_deg=-719.0)
    back = Command(rad(-20), enable=True)
    host.pass_ms(300, back)
    assert now(host.node.state) is DriveState.RUNNING, "held at the limit"
    host.pass_ms(200, STOP)
    host.command(STOP)
    data = CODEC.encode_reference(rad(-722.5), host.counter, host.heartbeat)
    host.node.receive(host.now_us, DRIVE_REFERENCE_ID, data)
    host.pass_ms(5, back)
    assert host.node.faults == DriveFault.ANGLE
    host.pass_ms(110, STOP)
    host.pass_ms(20, CLEAR)
    host.pass_ms(30, TURN)
    assert now(host.node.state) is DriveState.RUNNING
    host.pass_ms(10, back)
    assert host.node.state is DriveState.FAULT


@given(st.lists(st.binary(min_size=8, max_size=8), max_size=30))
def test_random_bytes_never_move_it(frames: list[bytes]) -> None:
    host = Host()
    for data in frames:
        host.node.receive(host.now_us, DRIVE_COMMAND_ID, data)
        host.pass_ms(1)
        assert host.velocity_rad_s == 0.0


@given(st.floats(-79, 79), st.floats(-720, 720), st.lists(st.floats(-7, 7), min_size=1, max_size=6))
def test_nodes_report_what_the_plant_put_on_their_inputs(
    torque_nmm: float, base_deg: float, hall_rad: list[float]
) -> None:
    counts = inputs(Measurement(0.0, rad(base_deg), nm(torque_nmm), tuple(hall_rad)))
    torque = CODEC.decode(*TorqueNode(CODEC).step(1000, counts.torque)[0])
    assert isinstance(torque, TorqueStatus)
    assert nmm(torque.torque_nm) == pytest.approx(torque_nmm, abs=1.01e-5)
    node = DriveNode(CODEC, LIMITS)
    node.step(0, 0)
    (*_, (frame_id, data)), _ = node.step(1000, counts.encoder)
    drive = CODEC.decode(frame_id, data)
    assert frame_id == DRIVE_STATUS_ID
    assert isinstance(drive, DriveStatus)
    assert drive.angle_rad == pytest.approx(rad(base_deg), abs=rad(0.00101))
    hall = decode_hall(HallNode().step(1000, counts.hall)[:-1])
    assert hall is not None
    for found, wanted in zip(hall.angle_rad, hall_rad, strict=True):
        assert abs(math.remainder(found - wanted, math.tau)) < 2 / HALL_AMPLITUDE_COUNTS
    assert all(HEALTHY_FIELD[0] <= field <= HEALTHY_FIELD[1] for field in hall.field)


def test_a_saturated_cell_is_said_to_be_saturated() -> None:
    counts = inputs(Measurement(0.0, 0.0, nm(500.0), (0.0,)))
    assert counts.torque == TORQUE_FULL_SCALE
    status = CODEC.decode(*TorqueNode(CODEC).step(1000, counts.torque)[0])
    assert isinstance(status, TorqueStatus)
    assert status.state == 2
