from __future__ import annotations

import itertools
import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.control.pid import PositionLoop
from needle_rig.simulation.drive.motor import Motor, MotorSettings
from needle_rig.units import deg, nm, rad

ENCODER_DEG = 0.01
DROOP = rad(1.0) / nm(1.0)


def drive_base(
    motor: Motor,
    target_deg: float,
    speed_deg_s: float = 45.0,
    seconds: float = 3.0,
    jitter: float = 0.3,
    seed: int = 1,
) -> list[tuple[float, float]]:
    """Angles in degrees over time while the loop turns `motor` to the target, ticks of 5 ms ± jitter."""
    loop = PositionLoop(10.0, 10.0, 0.0, rad(360.0))
    ticks = random.Random(seed)
    time_s, path = 0.0, []
    while time_s < abs(target_deg) / speed_deg_s + seconds:
        dt_s = 0.005 * (1.0 + jitter * ticks.uniform(-1.0, 1.0))
        motor.advance(dt_s, 0.0)
        time_s += dt_s
        seen = rad(round(deg(motor.angle_rad) / ENCODER_DEG) * ENCODER_DEG)
        motor.turn(loop.step(seen, rad(target_deg), rad(speed_deg_s), dt_s))
        path.append((time_s, deg(motor.angle_rad)))
    return path


@pytest.mark.parametrize(
    ("target_deg", "speed_deg_s"), [(45.0, 45.0), (-180.0, 60.0), (2.0, 45.0), (30.0, 15.0)]
)
@pytest.mark.parametrize("gain", [0.7, 1.0, 1.3])
@pytest.mark.parametrize("delay_s", [0.0, 0.005, 0.01])
@pytest.mark.parametrize("load_nmm", [-0.5, 0.0, 0.5])
def test_the_base_neither_overshoots_nor_stays_away(
    target_deg: float, speed_deg_s: float, gain: float, delay_s: float, load_nmm: float
) -> None:
    motor = Motor(MotorSettings(gain, delay_s, 0.010, DROOP, nm(load_nmm)))
    path = drive_base(motor, target_deg, speed_deg_s)
    overshoot = max((angle - target_deg) * math.copysign(1.0, target_deg) for _, angle in path)
    assert overshoot <= 0.1
    assert abs(path[-1][1] - target_deg) <= 0.05


def test_a_slow_drive_under_a_heavy_load_still_arrives() -> None:
    motor = Motor(MotorSettings(0.7, 0.01, 0.010, 10.0 * DROOP, nm(0.5)))
    assert drive_base(motor, 45.0, seconds=8.0)[-1][1] == pytest.approx(45.0, abs=0.02)


def test_the_base_turns_at_the_speed_that_was_asked_for() -> None:
    path = drive_base(Motor(MotorSettings()), 90.0, speed_deg_s=30.0, jitter=0.0)
    rates = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in itertools.pairwise(path)]
    assert max(rates) == pytest.approx(30.0, rel=1e-6)
    assert sorted(rates)[len(rates) * 9 // 10] >= 0.0
    assert min(rates) >= -0.5


def test_the_way_does_not_depend_on_the_turn_it_starts_from() -> None:
    near, far = Motor(MotorSettings()), Motor(MotorSettings(), angle_rad=rad(360.0))
    loop_near, loop_far = (PositionLoop(10.0, 10.0, 0.0, rad(360.0)) for _ in range(2))
    for _ in range(400):
        near.turn(loop_near.step(near.angle_rad, rad(170.0), 1.0, 0.005))
        far.turn(loop_far.step(far.angle_rad, rad(530.0), 1.0, 0.005))
        near.advance(0.005, 0.0)
        far.advance(0.005, 0.0)
        assert far.angle_rad - near.angle_rad == pytest.approx(rad(360.0), abs=1e-9)


def test_the_integral_does_not_wind_up_while_the_speed_is_clipped() -> None:
    loop = PositionLoop(10.0, 100.0, 0.0, rad(1e6))
    for _ in range(1000):
        loop.step(0.0, 1.0, 0.1, 0.01)
    # at the setpoint only an integral could ask for speed
    assert loop.step(1.0, 1.0, 0.1, 0.01) == 0.0


def test_the_integral_carries_a_load_that_the_gain_alone_cannot() -> None:
    loop = PositionLoop(10.0, 10.0, 0.0, rad(360.0))
    offset = rad(0.1)
    for _ in range(200):
        velocity = loop.step(-offset, 0.0, 1.0, 0.005)
    assert velocity == pytest.approx(offset * (10.0 + 10.0 * 1.0), rel=0.02)
    loop.reset()
    assert loop.step(0.0, 0.0, 1.0, 0.005) == 0.0


@given(
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(0.01, 1.0),
    st.lists(st.floats(1e-4, 0.05), min_size=1, max_size=50),
)
def test_speed_and_acceleration_stay_within_their_limits(
    angle: float, setpoint: float, speed: float, ticks: list[float]
) -> None:
    loop = PositionLoop(10.0, 10.0, 0.0, 2.0)
    before = 0.0
    for dt_s in ticks:
        velocity = loop.step(angle, setpoint, speed, dt_s)
        assert abs(velocity) <= speed + 1e-12
        assert abs(velocity - before) <= 2.0 * dt_s + 1e-12
        angle, before = angle + velocity * dt_s, velocity
