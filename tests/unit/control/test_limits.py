from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.control.faults import Fault, FaultName
from needle_rig.control.limits import (
    ANGLE_MARGIN_RAD,
    DRIVE_SENTENCES,
    Gated,
    Limits,
    drive_faults,
    find_faults,
    gate,
    heard_age_s,
    slow_host_fault,
    tick_fault,
)
from needle_rig.records import STOP, Command, DriveFault, DriveState, Measurement
from needle_rig.units import rad
from tests.values import known

LIMITS = Limits(
    angle_rad=10.0,
    velocity_rad_s=1.0,
    acceleration_rad_s2=4.0,
    torque_nm=2e-3,
    torque_age_s=0.05,
    hall_age_s=0.06,
    drive_age_s=0.07,
)
GOOD = Measurement(
    time_s=1.0,
    base_angle_rad=0.5,
    torque_nm=1e-4,
    hall_rad=(0.1, 0.2),
    drive_state=DriveState.RUNNING,
    torque_age_s=0.001,
    hall_age_s=0.001,
    drive_age_s=0.001,
)


def having(**changes: Any) -> Measurement:
    return dataclasses.replace(GOOD, **changes)


def first_fault(measurement: Measurement, limits: Limits) -> Fault | None:
    own = drive_faults(measurement.drive_state, measurement.drive_faults, measurement.drive_complaint)
    return next(iter([*find_faults(measurement, limits)[1], *own]), None)


def only(state: DriveState, bit: DriveFault) -> Fault:
    (fault,) = drive_faults(state, bit)
    return fault


def test_a_healthy_rig_has_no_fault() -> None:
    assert first_fault(GOOD, LIMITS) is None


@pytest.mark.parametrize(("link", "limit_s"), [("torque", 0.05), ("hall", 0.06), ("drive", 0.07)])
def test_a_value_at_the_age_limit_counts_and_one_beyond_it_is_a_temporary_fault(
    link: str, limit_s: float
) -> None:
    field = f"{link}_age_s"
    assert first_fault(having(**{field: limit_s}), LIMITS) is None
    fault = known(first_fault(having(**{field: limit_s + 0.0011}), LIMITS))
    assert (fault.link, fault.latching) == (link, False)
    assert fault.text == (
        f"the {link} link is dead: its newest value is {limit_s * 1e3 + 1:.0f} ms old, limit"
        f" {limit_s * 1e3:g} ms; check {WHERE[link]}"
    )


WHERE = {
    "torque": "the torque sensor, cable and supply",
    "hall": "the Hall sensors, cable and supply",
    "drive": "the drive, cable and supply",
}


def heard_ages(ages_and_ticks: Sequence[tuple[float, float]], listening_s: float = 0.01) -> list[float]:
    heard_s, found = math.inf, []
    for age_s, dt_s in ages_and_ticks:
        heard_s = heard_age_s(heard_s, age_s, dt_s, listening_s)
        found.append(heard_s)
    return found


def test_to_a_host_that_keeps_time_a_silent_link_is_as_old_as_its_value() -> None:
    growing = [(0.001 + 0.005 * k, 0.005) for k in range(40)]
    assert heard_ages(growing) == pytest.approx([age_s for age_s, _ in growing])


def test_of_a_tick_that_came_late_only_its_share_is_held_against_the_link() -> None:
    assert heard_ages([(0.001, 0.005), (0.201, 0.2), (0.206, 0.005)]) == pytest.approx([0.001, 0.011, 0.016])
    assert heard_ages([(0.001, 0.005), (0.011, 0.01), (0.022, 0.011)]) == pytest.approx([0.001, 0.011, 0.021])


def test_a_tick_as_long_as_the_host_listens_is_not_late() -> None:
    assert heard_ages([(0.0, 0.005), (0.1, 0.1), (0.11, 0.01)]) == pytest.approx([0.0, 0.01, 0.02])


def test_a_fresh_value_and_one_that_was_never_there_are_judged_at_once() -> None:
    assert heard_ages([(0.04, 0.005), (0.002, 0.005)]) == [0.04, 0.002]
    assert heard_ages([(math.inf, 0.005), (0.3, 0.005)]) == [math.inf, 0.3]
    assert heard_ages([(0.002, 0.005), (math.inf, 0.005)]) == [0.002, math.inf]
    assert math.isnan(heard_ages([(0.002, 0.005), (math.nan, 0.005)])[-1])


@pytest.mark.parametrize(
    ("tick_s", "dead_s"), [(0.005, 0.055), (0.012, 0.072), (0.02, 0.06), (0.04, 0.08), (0.045, 0.09)]
)
def test_a_host_that_is_always_late_is_forgiven_once(tick_s: float, dead_s: float) -> None:
    ticks = [(tick_s * k, tick_s) for k in range(1, 12)]
    ages = zip(heard_ages([(0.0, tick_s), *ticks])[1:], ticks, strict=True)
    assert next(age_s for heard_s, (age_s, _) in ages if heard_s > 0.0501) == pytest.approx(dead_s)


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(1e-4, 1)), min_size=1))
def test_what_is_held_against_a_link_is_its_age_or_what_was_listened(
    ticks: list[tuple[float, float]],
) -> None:
    found = heard_ages(ticks)
    assert all(heard_s <= age_s for heard_s, (age_s, _) in zip(found, ticks, strict=True))
    for before_s, heard_s, (age_s, dt_s) in zip(found, found[1:], ticks[1:], strict=False):
        assert heard_s == age_s or heard_s == pytest.approx(before_s + min(dt_s, 0.01))


@pytest.mark.parametrize("link", ["torque", "hall", "drive"])
@pytest.mark.parametrize("age", [math.inf, math.nan])
def test_a_link_without_a_value_is_named(link: str, age: float) -> None:
    fault = known(first_fault(having(**{f"{link}_age_s": age}), LIMITS))
    assert (fault.link, fault.latching) == (link, False)
    if math.isinf(age):
        assert fault.text == f"the {link} link has given no value yet; check {WHERE[link]}"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("link", "field", "wrap"),
    [
        ("torque", "torque_nm", lambda x: x),
        ("hall", "hall_rad", lambda x: (0.1, x)),
        ("drive", "base_angle_rad", lambda x: x),
    ],
)
def test_a_value_that_is_no_number_is_a_temporary_fault_of_its_link(
    bad: float, link: str, field: str, wrap: Callable[[float], object]
) -> None:
    fault = known(first_fault(having(**{field: wrap(bad)}), LIMITS))
    assert (fault.link, fault.latching) == (link, False)
    assert f"the {link} link gives" in fault.text
    assert "no number" in fault.text


@pytest.mark.parametrize("sign", [1, -1])
def test_torque_beyond_its_limit_trips_and_latches(sign: int) -> None:
    assert first_fault(having(torque_nm=sign * LIMITS.torque_nm), LIMITS) is None
    fault = known(first_fault(having(torque_nm=sign * LIMITS.torque_nm * 1.001), LIMITS))
    assert (fault.link, fault.latching) == ("torque", True)
    assert f"{sign * 2.002:.3f} N·mm, above the limit of 2 N·mm" in fault.text
    assert fault.text.endswith("then: needle-rig clear")


@pytest.mark.parametrize("sign", [1, -1])
def test_an_angle_beyond_its_limit_latches(sign: int) -> None:
    assert first_fault(having(base_angle_rad=sign * (10.0 + ANGLE_MARGIN_RAD)), LIMITS) is None
    fault = known(first_fault(having(base_angle_rad=sign * (10.0 + rad(1.001))), LIMITS))
    assert (fault.link, fault.latching) == ("drive", True)
    assert f"the base stands at {sign * 574.0:.1f}°, outside ±572.958°" in fault.text
    assert "by more than 1°; turn it back" in fault.text


def test_how_old_a_command_may_be_is_said_in_milliseconds() -> None:
    assert DRIVE_SENTENCES[DriveFault.COMMAND_AGE].startswith("no valid command reached it for 50 ms;")


@pytest.mark.parametrize("bit", list(DriveFault))
def test_every_fault_bit_of_the_drive_has_its_sentence(bit: DriveFault) -> None:
    if bit is DriveFault.NONE:
        return
    fault = only(DriveState.FAULT, bit)
    temporary = bit in (DriveFault.COMMAND_AGE, DriveFault.FRAME, DriveFault.TORQUE_AGE)
    assert fault.text == f"the drive stopped by itself: {DRIVE_SENTENCES[bit]}" + (
        "" if temporary else ", then: needle-rig clear"
    )
    assert fault.link == "drive"
    assert fault.latching is not temporary


def test_every_bit_is_a_fault_of_its_own() -> None:
    bits = DriveFault.COMMAND_AGE | DriveFault.ENCODER | DriveFault.STALL
    found = drive_faults(DriveState.FAULT, bits, "so it says")
    assert [(f.name, f.bit, f.latching) for f in found] == [
        (FaultName.DRIVE, DriveFault.COMMAND_AGE, False),
        (FaultName.DRIVE, DriveFault.ENCODER, True),
        (FaultName.NOT_TURNING, DriveFault.NONE, True),
    ]
    assert [f.text for f in found] == [
        f"the drive stopped by itself: {DRIVE_SENTENCES[bit]}; so it says{end}"
        for bit, end in (
            (DriveFault.COMMAND_AGE, ""),
            (DriveFault.ENCODER, ", then: needle-rig clear"),
            (DriveFault.STALL, ", then: needle-rig clear"),
        )
    ]


def test_a_drive_in_fault_without_a_reason_latches() -> None:
    fault = only(DriveState.FAULT, DriveFault.NONE)
    assert fault.latching
    assert "gives no reason" in fault.text


@pytest.mark.parametrize("state", [DriveState.SILENT, DriveState.READY, DriveState.RUNNING])
def test_a_drive_without_faults_is_none(state: DriveState) -> None:
    assert drive_faults(state, DriveFault.NONE) == []


def test_the_gate_asks_the_drive() -> None:
    gated = gate(0.1, having(drive_faults=DriveFault.ENCODER), 0.0, 0.005, LIMITS)
    assert (gated.command, gated.fault) == (STOP, only(DriveState.RUNNING, DriveFault.ENCODER))


def test_a_dead_link_hides_what_it_alone_tells_and_no_more() -> None:
    heard, found = find_faults(having(hall_age_s=1.0, torque_nm=1.0, base_angle_rad=11.0), LIMITS)
    assert heard == {"torque", "drive"}
    assert [fault.name for fault in found] == [
        FaultName.LINK_DEAD,
        FaultName.TORQUE_LIMIT,
        FaultName.ANGLE_LIMIT,
    ]
    heard, found = find_faults(having(drive_age_s=1.0, base_angle_rad=11.0, torque_nm=math.nan), LIMITS)
    assert heard == {"hall"}
    assert [fault.name for fault in found] == [FaultName.LINK_DEAD, FaultName.NOT_A_NUMBER]


def test_a_link_at_its_oldest_is_heard_beside_a_dead_one() -> None:
    links = ("torque", "hall", "drive")
    oldest = {f"{link}_age_s": getattr(LIMITS, f"{link}_age_s") for link in links}
    for dead in links:
        heard, _ = find_faults(having(**(oldest | {f"{dead}_age_s": 1.0})), LIMITS)
        assert heard == {*links} - {dead}


def test_dead_links_come_before_bad_values() -> None:
    fault = known(first_fault(having(hall_age_s=1.0, torque_nm=math.nan), LIMITS))
    assert fault.link == "hall"


@pytest.mark.parametrize("dt_s", [0.0, -0.001, math.nan, math.inf])
def test_a_tick_of_impossible_length_is_a_temporary_fault(dt_s: float) -> None:
    fault = known(tick_fault(dt_s))
    assert (fault.link, fault.latching) == ("control", False)
    assert f"took {dt_s} s" in fault.text
    assert gate(0.0, GOOD, 0.0, dt_s, LIMITS) == Gated(STOP, limited=False, fault=fault)


def test_a_shortest_tick_is_allowed() -> None:
    assert tick_fault(1e-9) is None


def test_a_wish_within_all_limits_goes_out_unchanged() -> None:
    assert gate(0.5, GOOD, 0.49, 0.005, LIMITS) == Gated(Command(0.5, enable=True), limited=False)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_wish_above_the_velocity_limit_is_limited_not_a_fault(sign: int) -> None:
    gated = gate(sign * 1.5, GOOD, sign * 1.0, 0.005, LIMITS)
    assert gated == Gated(Command(sign * 1.0, enable=True), limited=True)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_change_above_the_acceleration_limit_is_limited(sign: int) -> None:
    gated = gate(sign * 0.5, GOOD, sign * 0.1, 0.01, LIMITS)
    assert gated.command.velocity_rad_s == pytest.approx(sign * 0.14)
    assert gated.limited
    assert gate(sign * 0.14, GOOD, sign * 0.1, 0.01, LIMITS).limited is False


@pytest.mark.parametrize("sign", [1, -1])
def test_speed_towards_the_angle_limit_leaves_room_to_brake(sign: int) -> None:
    near = having(base_angle_rad=sign * 9.98)
    gated = gate(sign * 1.0, near, sign * 1.0, 10.0, LIMITS)
    assert gated.command.velocity_rad_s == pytest.approx(sign * math.sqrt(2 * 4.0 * 0.02))
    assert gated.limited
    assert gate(-sign * 1.0, near, -sign * 1.0, 0.005, LIMITS).command.velocity_rad_s == -sign * 1.0


@pytest.mark.parametrize("sign", [1, -1])
def test_at_the_angle_limit_only_the_way_back_is_open(sign: int) -> None:
    there = having(base_angle_rad=sign * 10.0)
    assert gate(sign * 1.0, there, 0.0, 0.005, LIMITS).command == Command(0.0, enable=True)
    assert gate(-sign * 0.02, there, 0.0, 0.005, LIMITS).command == Command(-sign * 0.02, enable=True)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_base_that_overshot_the_limit_by_little_may_turn_back(sign: int) -> None:
    there = having(base_angle_rad=sign * (10.0 + rad(0.9)))
    assert gate(sign * 1.0, there, 0.0, 0.005, LIMITS).command == Command(0.0, enable=True)
    assert gate(-sign * 0.02, there, 0.0, 0.005, LIMITS).command == Command(-sign * 0.02, enable=True)


@pytest.mark.parametrize("wish", [math.nan, math.inf, -math.inf])
def test_a_wish_that_is_no_number_stops_and_latches(wish: float) -> None:
    gated = gate(wish, GOOD, 0.5, 0.005, LIMITS)
    assert gated.command == STOP
    fault = known(gated.fault)
    assert (fault.link, fault.latching, gated.limited) == ("control", True, False)
    assert "no number" in fault.text


def test_a_fault_stops_whatever_is_wished() -> None:
    gated = gate(0.5, having(torque_nm=1.0), 0.5, 0.005, LIMITS)
    assert gated.command == STOP
    assert gated.fault == first_fault(having(torque_nm=1.0), LIMITS)


FLOATS = st.floats(allow_nan=True, allow_infinity=True)


@given(FLOATS, FLOATS, FLOATS, st.floats(-2, 2), FLOATS, st.floats(0, 0.2), st.floats(0, 0.2))
def test_nothing_that_comes_in_lets_a_command_beyond_its_limits_out(
    wish: float, angle: float, torque: float, last: float, dt_s: float, hall_age: float, drive_age: float
) -> None:
    measurement = having(base_angle_rad=angle, torque_nm=torque, hall_age_s=hall_age, drive_age_s=drive_age)
    last = min(max(last, -1.0), 1.0)
    gated = gate(wish, measurement, last, dt_s, LIMITS)
    command = gated.command
    if gated.fault is not None:
        assert command == STOP
    else:
        assert command.enable
        assert abs(command.velocity_rad_s) <= LIMITS.velocity_rad_s
        assert abs(command.velocity_rad_s - last) <= LIMITS.acceleration_rad_s2 * dt_s + 1e-12
        assert abs(angle) <= LIMITS.angle_rad
        assert hall_age <= LIMITS.hall_age_s
        assert drive_age <= LIMITS.drive_age_s


def test_a_long_dead_link_tells_its_age_to_the_millisecond() -> None:
    assert "12345 ms old, limit 60 ms" in known(first_fault(having(hall_age_s=12.345), LIMITS)).text


@pytest.mark.parametrize("words", [LIMITS, Gated(STOP, False), tick_fault(0.0)])
def test_nothing_that_was_decided_can_be_changed_afterwards(words: Limits | Gated | Fault) -> None:
    name = dataclasses.fields(words)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(words, name, None)


def test_every_fault_has_its_name() -> None:
    for link in ("torque", "hall", "drive"):
        assert known(first_fault(having(**{f"{link}_age_s": 1.0}), LIMITS)).name is FaultName.LINK_DEAD
    for field in ("torque_nm", "base_angle_rad"):
        assert known(first_fault(having(**{field: math.nan}), LIMITS)).name is FaultName.NOT_A_NUMBER
    assert known(first_fault(having(hall_rad=(0.1, math.nan)), LIMITS)).name is FaultName.NOT_A_NUMBER
    assert known(first_fault(having(torque_nm=0.1), LIMITS)).name is FaultName.TORQUE_LIMIT
    assert known(first_fault(having(base_angle_rad=11.0), LIMITS)).name is FaultName.ANGLE_LIMIT
    assert known(tick_fault(0.0)).name is FaultName.LATE_TICK
    assert known(gate(math.nan, GOOD, 0.0, 0.005, LIMITS).fault).name is FaultName.CONTROL


@pytest.mark.parametrize(
    ("bit", "name"),
    [
        (DriveFault.STALL, FaultName.NOT_TURNING),
        (DriveFault.RUNAWAY, FaultName.RUNAWAY),
        (DriveFault.DIRECTION, FaultName.WRONG_DIRECTION),
        (DriveFault.IDLE_MOTION, FaultName.IDLE_MOTION),
        (DriveFault.MASTER, FaultName.SECOND_MASTER),
        (DriveFault.EMERGENCY_STOP, FaultName.EMERGENCY_STOP),
        (DriveFault.ANGLE, FaultName.ANGLE_LIMIT),
        (DriveFault.TORQUE_TRIP, FaultName.TORQUE_LIMIT),
        (DriveFault.HEARTBEAT, FaultName.DRIVE),
    ],
)
def test_what_drive_and_host_both_know_has_one_name(bit: DriveFault, name: FaultName) -> None:
    fault = only(DriveState.FAULT, bit)
    assert (fault.name, fault.latching) == (name, True)


def test_a_pressed_emergency_stop_latches_whatever_the_drive_says() -> None:
    fault = known(first_fault(having(emergency_stop=True), LIMITS))
    assert (fault.name, fault.link, fault.latching) == (FaultName.EMERGENCY_STOP, "drive", True)
    assert fault.text == "the emergency stop is pressed; release it, then: needle-rig clear"


@pytest.mark.parametrize(("link", "limit_s"), [("torque", 0.05), ("hall", 0.06), ("drive", 0.07)])
def test_a_slow_host_counts_a_link_dead_that_will_be_at_the_next_tick(link: str, limit_s: float) -> None:
    edge = {f"{link}_age_s": limit_s - 0.02}
    assert slow_host_fault(having(**edge), 0.0199, LIMITS) is None
    exact = having(**{f"{link}_age_s": limit_s / 2})
    assert slow_host_fault(exact, limit_s / 2, LIMITS) is None
    fault = known(slow_host_fault(having(**edge), 0.0202, LIMITS))
    assert (fault.name, fault.link, fault.latching) == (FaultName.LATE_TICK, link, False)
    assert fault.text == (
        f"this computer is too slow for the {link} link: its newest value is {limit_s * 1e3 - 20:.0f} ms old,"
        f" the next look at it comes in 20 ms, limit {limit_s * 1e3:g} ms;"
        " end other programs, or lower tick_hz"
    )
    assert slow_host_fault(GOOD, 0.045, LIMITS) is None


def test_a_slow_host_tells_long_times_to_the_millisecond() -> None:
    text = known(slow_host_fault(having(torque_age_s=12.345), 7.654, LIMITS)).text
    assert "12345 ms old, the next look at it comes in 7654 ms, limit 50 ms" in text


def test_what_a_drive_of_another_make_says_is_in_the_sentence_and_latches() -> None:
    fault = first_fault(
        having(drive_state=DriveState.FAULT, drive_complaint="emergency 0x2310 (over-current)"), LIMITS
    )
    assert fault is not None
    assert fault.latching
    assert fault.text == (
        "the drive stopped by itself: emergency 0x2310 (over-current), then: needle-rig clear"
    )


def test_a_complaint_of_a_drive_that_goes_on_is_no_fault() -> None:
    assert first_fault(having(drive_complaint="emergency 0x4210 (too hot)"), LIMITS) is None
