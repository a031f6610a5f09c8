"""Devices fed by hand: angles that turn on and on, cells that cannot measure, adapters that send noise."""

from __future__ import annotations

import asyncio
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needle_rig.config.schema import CanSection, SerialSection
from needle_rig.devices.can_bus import CanLink
from needle_rig.devices.hall_serial import HallSerial
from needle_rig.devices.torque_can import TorqueCan
from needle_rig.simulation.slcan_hub import Pty
from needle_rig.wire.can_frames import TorqueStatus
from needle_rig.wire.hall_frames import encode_hall


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def hall(clock: Clock) -> HallSerial:
    return HallSerial(SerialSection(port="/dev/none"), ("hall_1", "hall_2"), now=clock)


@given(st.lists(st.floats(-1.5, 1.5), min_size=40, max_size=200))
def test_angles_are_followed_over_any_number_of_turns(steps_rad: list[float]) -> None:
    clock = Clock()
    device = hall(clock)
    angle = 0.0
    for index in range(30):
        device.data_received(encode_hall(index, index * 1000, [0.0, 1.0], [40_000] * 2))
        clock.now_s += 1e-3
    for index, step in enumerate(steps_rad, 30):
        angle += step
        device.data_received(encode_hall(index, index * 1000, [angle, 1.0 - angle], [40_000] * 2))
        clock.now_s += 1e-3
        assert device.angle_rad == pytest.approx((angle, 1.0 - angle), abs=2e-6)
    assert device.age_s(clock.now_s) < 0.002


def test_a_sensor_without_a_magnet_grows_old_alone_and_is_named() -> None:
    clock = Clock()
    device = hall(clock)
    for index in range(200):
        field = [40_000, 40_000 if index < 100 else 500]
        device.data_received(encode_hall(index, index * 1000, [index * 1e-3, index * 1e-3], field))
        clock.now_s += 1e-3
    assert device.angle_rad == pytest.approx((0.199, 0.099), abs=1e-6)
    assert device.age_s(clock.now_s) == pytest.approx(0.101, abs=1e-6)
    assert device.complaint == "hall_2 sees a field of 500, healthy is 20000 to 60000"


@pytest.mark.parametrize(
    ("state", "complaint"), [(1, "starting"), (2, "saturated"), (3, "fault"), (9, "state 9")]
)
def test_a_torque_that_the_node_does_not_vouch_for_counts_as_none(state: int, complaint: str) -> None:
    device = TorqueCan(167.77216)
    for index in range(300):
        bad = index >= 100
        status = TorqueStatus(9.0 if bad else 1e-4, state if bad else 0, index % 16, index * 1e-3)
        device.take(status, index * 1e-3)
    assert device.torque_nm == 1e-4
    assert device.age_s(0.3) > 0.19
    assert complaint in device.complaint


def test_nothing_is_known_before_the_first_reading() -> None:
    device = TorqueCan(167.77216)
    assert math.isnan(device.torque_nm)
    assert math.isinf(device.age_s(1.0))
    assert math.isinf(hall(Clock()).age_s(1.0))


lines = st.one_of(
    st.binary(max_size=40),
    st.text("tTrRdDbBx0123456789ABCDEFz\r\a", max_size=60).map(str.encode),
)


@settings(max_examples=40)
@given(st.lists(lines, max_size=20))
def test_whatever_an_adapter_sends_the_next_good_frame_is_taken(noise: list[bytes]) -> None:
    async def scenario() -> None:
        port = Pty()
        got: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()

        def on_frame(frame_id: int, data: bytes, now_s: float) -> None:
            if (frame_id, data) == (0x101, b"\xde\xad\xbe\xef\x00\x11\x22\x33") and not got.done():
                got.set_result(data)

        link = CanLink(CanSection(channel=port.name), on_frame)
        link.open()
        port.write(b"".join(noise) + b"\rt1018DEADBEEF00112233\r")
        port.flush()
        try:
            async with asyncio.timeout(10):
                await got
            assert not link.lost
        finally:
            link.close()
            port.close()

    asyncio.run(scenario())
