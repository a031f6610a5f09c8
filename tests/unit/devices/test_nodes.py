"""Devices fed by hand: angles that turn on and on, cells that cannot measure, adapters that send noise."""

from __future__ import annotations

import asyncio
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.config.files import find_config_file
from needle_rig.config.schema import CanSection, NodeDevice, SerialSection
from needle_rig.devices.can_bus import CanLink
from needle_rig.devices.device import Frames
from needle_rig.devices.drive_can import DriveCan
from needle_rig.devices.hall_serial import HallSerial
from needle_rig.devices.memory_host import MemoryHost
from needle_rig.devices.torque_can import TorqueCan
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.simulation.nodes.slcan_hub import Pty
from needle_rig.wire.can_frames import (
    DRIVE_HEALTH_ID,
    DRIVE_STATUS_ID,
    TORQUE_STATUS_ID,
    CanCodec,
    DriveCommand,
    DriveHealth,
    DriveReference,
)
from needle_rig.wire.hall_frames import encode_hall


def hall() -> tuple[HallSerial, MemoryHost]:
    host = MemoryHost(("hall_1", "hall_2"))
    return HallSerial(SerialSection(port="/dev/none"), host), host


@given(st.lists(st.floats(-1.5, 1.5), min_size=40, max_size=200))
def test_angles_are_followed_over_any_number_of_turns(steps_rad: list[float]) -> None:
    device, host = hall()
    angle = 0.0
    for index in range(30):
        host.bring(0, encode_hall(index, index * 1000, [0.0, 1.0], [40_000] * 2))
        host.now_s += 1e-3
    for index, step in enumerate(steps_rad, 30):
        angle += step
        host.bring(0, encode_hall(index, index * 1000, [angle, 1.0 - angle], [40_000] * 2))
        host.now_s += 1e-3
        assert device.angle_rad == pytest.approx((angle, 1.0 - angle), abs=2e-6)
    assert device.age_s(host.now_s) < 0.002


def test_a_sensor_without_a_magnet_grows_old_alone_and_is_named() -> None:
    device, host = hall()
    for index in range(200):
        field = [40_000, 40_000 if index < 100 else 500]
        host.bring(0, encode_hall(index, index * 1000, [index * 1e-3, index * 1e-3], field))
        host.now_s += 1e-3
    assert device.angle_rad == pytest.approx((0.199, 0.099), abs=1e-6)
    assert device.age_s(host.now_s) == pytest.approx(0.101, abs=1e-6)
    assert device.complaint(host.now_s) == "hall_2 sees a field of 500, healthy is 20000 to 60000"


def test_of_frames_that_came_at_once_the_newest_that_is_news_has_the_angles_and_all_are_recorded() -> None:
    device, host = hall()
    for tick in range(20):
        frames = [
            encode_hall(index, index * 1000, [index * 1e-3, -index * 1e-3], [40_000] * 2)
            for index in range(5 * tick, 5 * tick + 5)
        ]
        host.bring(0, b"".join(frames))
        host.now_s += 5e-3
        assert [row[2] for _, row in host.rows] == list(range(5 * tick + 5))
        if tick > 10:
            newest_rad = (5 * tick + 4) * 1e-3
            assert device.angle_rad == pytest.approx((newest_rad, -newest_rad), abs=2e-6)
    # a replay at the end of what came at once is recorded, and no news
    late = encode_hall(100, 100_000, [0.1, -0.1], [40_000] * 2)
    host.bring(0, late + encode_hall(99, 600_000, [1.0, 1.0], [40_000] * 2))
    assert [row[2] for _, row in host.rows[-2:]] == [100.0, 99.0]
    assert device.angle_rad == pytest.approx((0.1, -0.1), abs=2e-6)


def hall_after_an_outage(
    away_s: float, base_deg: tuple[float, float], hall_deg: float, base_known_frames: int = 60
) -> tuple[HallSerial, MemoryHost]:
    """Sensors that stood at 100°, were away, and came back at `hall_deg` while the base moved.

    The base's angle was known at the first `base_known_frames` of the 60 frames before.
    """
    host = MemoryHost(("hall_1",))
    host.base_is_rad = math.radians(base_deg[0])
    device = HallSerial(SerialSection(port="/dev/none"), host)
    for index in range(60):
        if index == base_known_frames:
            host.base_is_rad = math.nan
        host.bring(0, encode_hall(index, index * 1000, [math.radians(100.0)], [40_000]))
        host.now_s += 1e-3
    host.now_s += away_s
    host.base_is_rad = math.radians(base_deg[1])
    for index in range(60, 120):
        time_us = index * 1000 + round(away_s * 1e6)
        host.bring(0, encode_hall(index, time_us, [math.radians(hall_deg)], [40_000]))
        host.now_s += 1e-3
    return device, host


@pytest.mark.parametrize("moved_deg", [-700.0, -200.0, 0.0, 30.0, 200.0, 540.0])
@pytest.mark.parametrize("lag_deg", [-40.0, 0.0, 40.0])
def test_turns_in_an_outage_are_those_of_the_base(moved_deg: float, lag_deg: float) -> None:
    device, host = hall_after_an_outage(1.0, (10.0, 10.0 + moved_deg), 100.0 + moved_deg + lag_deg)
    assert math.degrees(device.angle_rad[0]) == pytest.approx(100.0 + moved_deg + lag_deg, abs=1e-3)
    assert device.complaint(host.now_s) == ""


@pytest.mark.parametrize(("off_deg", "sure"), [(89.0, True), (-89.0, True), (91.0, False), (-91.0, False)])
def test_turns_that_could_be_others_are_not_guessed_until_somebody_says_where_the_base_stands(
    off_deg: float, sure: bool
) -> None:
    device, host = hall_after_an_outage(0.4, (10.0, 210.0), 300.0 + off_deg)
    now_s = host.now_s
    assert (device.age_s(now_s) < 0.05) == sure
    assert ("its turns are not known; give the base its reference anew" in device.complaint(now_s)) != sure
    if not sure:
        assert math.degrees(device.angle_rad[0]) == pytest.approx(100.0, abs=1e-3)
        device.refer(math.radians(300.0))
        index, angle_rad = 120, math.radians(300.0 + off_deg)
        host.bring(0, encode_hall(index, index * 1000 + 400_000, [angle_rad], [40_000]))
        assert math.degrees(device.angle_rad[0]) == pytest.approx(300.0 + off_deg, abs=1e-3)
        assert (device.complaint(now_s), device.age_s(now_s) < 0.05) == ("", True)


def test_turns_wait_for_a_base_that_is_not_known() -> None:
    device, host = hall_after_an_outage(0.4, (10.0, math.nan), 110.0)
    assert "its turns wait for the drive's angle" in device.complaint(host.now_s)
    assert device.age_s(host.now_s) > 0.4


def test_a_base_not_known_when_the_sensor_fell_silent_tells_the_turns_by_what_was_known_before() -> None:
    device, host = hall_after_an_outage(1.0, (10.0, 210.0), 300.0, base_known_frames=59)
    assert math.degrees(device.angle_rad[0]) == pytest.approx(300.0, abs=1e-3)
    assert device.complaint(host.now_s) == ""


def test_a_sensor_that_was_away_before_the_base_was_ever_known_starts_anew() -> None:
    device, host = hall_after_an_outage(1.0, (10.0, 12.0), 102.0, base_known_frames=0)
    assert math.degrees(device.angle_rad[0]) == pytest.approx(102.0, abs=1e-3)
    assert device.complaint(host.now_s) == ""


def test_a_short_gap_needs_no_base() -> None:
    device, _ = hall_after_an_outage(0.15, (math.nan, math.nan), 110.0)
    assert math.degrees(device.angle_rad[0]) == pytest.approx(110.0, abs=1e-3)


CODEC = CanCodec(find_config_file("needle_rig.dbc"))


START_S = MemoryHost().now_s


def drive() -> tuple[DriveCan, MemoryHost]:
    host = MemoryHost()
    return DriveCan(NodeDevice(), host), host


def drive_that_speaks(health_until_s: float) -> DriveCan:
    """A drive whose statuses come for 0.5 s and whose health comes until `health_until_s`."""
    device, host = drive()
    for ms in range(500):
        now_s = ms * 1e-3
        host.now_s = START_S + now_s
        if ms % 10 == 0 and now_s < health_until_s:
            health = DriveHealth(DriveFault.STALL, True, False, True, 0.5, 3, ms // 10)
            host.bring(DRIVE_HEALTH_ID, CODEC.encode_health(health))
        status = CODEC.encode_drive(0.25, DriveState.FAULT, DriveFault.VELOCITY, ms, now_s)
        host.bring(DRIVE_STATUS_ID, status)
    return device


def test_status_and_health_make_one_drive() -> None:
    device = drive_that_speaks(1.0)
    assert device.faults == DriveFault.STALL | DriveFault.VELOCITY
    assert (device.referenced, device.supply_on, device.emergency_stop) == (True, True, False)
    assert (device.index_rad, device.angle_rad) == pytest.approx((0.5, 0.25), abs=1e-5)
    assert device.age_s(START_S + 0.5) < 0.01


@pytest.mark.parametrize(("missing_s", "dead"), [(0.085, False), (0.13, True)])
def test_a_health_that_stays_away_is_a_dead_drive(missing_s: float, dead: bool) -> None:
    assert (drive_that_speaks(0.5 - missing_s).age_s(START_S + 0.5) > 0.1) == dead


def test_without_any_health_a_drive_is_not_known() -> None:
    assert math.isinf(drive_that_speaks(-1.0).age_s(START_S + 0.5))
    assert "sends no DRIVE_HEALTH; flash the firmware" in drive_that_speaks(0.0).complaint(START_S + 0.5)
    assert drive_that_speaks(0.5).complaint(START_S + 0.5) == ""


def test_a_reference_goes_out_after_its_command_with_the_same_heartbeat() -> None:
    device, host = drive()
    device.command(Command())
    device.command(Command(reference_rad=-0.5))
    sent = [CODEC.decode(*frame) for frame in host.sent]
    assert [type(content) for content in sent] == [DriveCommand, DriveCommand, DriveReference]
    command, reference = sent[1:]
    assert isinstance(command, DriveCommand)
    assert isinstance(reference, DriveReference)
    assert not command.command.enable
    assert (reference.counter, reference.heartbeat) == (command.counter, command.heartbeat) == (2, 2)
    assert reference.angle_rad == pytest.approx(-0.5, abs=1e-5)


@pytest.mark.parametrize(
    ("state", "complaint"), [(1, "starting"), (2, "saturated"), (3, "fault"), (9, "state 9")]
)
def test_a_torque_that_the_node_does_not_vouch_for_counts_as_none(state: int, complaint: str) -> None:
    host = MemoryHost()
    device = TorqueCan(NodeDevice(), host)
    for index in range(300):
        bad = index >= 100
        status = CODEC.encode_torque(9.0 if bad else 1e-4, state if bad else 0, index, index * 1e-3)
        host.now_s = START_S + index * 1e-3
        host.bring(TORQUE_STATUS_ID, status)
    assert device.torque_nm == pytest.approx(1e-4, abs=1e-9)
    assert device.age_s(START_S + 0.3) > 0.19
    assert complaint in device.complaint(host.now_s)


def test_nothing_is_known_before_the_first_reading() -> None:
    device = TorqueCan(NodeDevice(), MemoryHost())
    assert math.isnan(device.torque_nm)
    assert math.isinf(device.age_s(START_S))
    assert math.isinf(hall()[0].age_s(START_S))


lines = st.one_of(
    st.binary(max_size=40),
    st.text("tTrRdDbBx0123456789ABCDEFz\r\a", max_size=60).map(str.encode),
)


@given(st.lists(lines, max_size=20))
def test_whatever_an_adapter_sends_the_next_good_frame_is_taken(noise: list[bytes]) -> None:
    async def scenario() -> None:
        port = Pty()
        got: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()

        def on_frames(frames: Frames, now_s: float) -> None:
            if (0x101, b"\xde\xad\xbe\xef\x00\x11\x22\x33") in frames and not got.done():
                got.set_result(frames[-1][1])

        link = CanLink(CanSection(channel=port.name), on_frames)
        link.open()
        port.write(b"".join(noise) + b"\rt1018DEADBEEF00112233\r")
        port.flush()
        try:
            async with asyncio.timeout(10):
                await got
            assert not link.lost
        finally:
            await link.close()
            port.close()

    asyncio.run(scenario())
