"""The guard: every limit dense around its edge, every fault entered and left, every state held."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needle_rig.control.limits import DRIVE_SENTENCES
from needle_rig.firmware.host import HostNodes
from needle_rig.records import COMMAND_AGE_S, DriveFault, DriveState
from tests.firmware.harness import Guard
from tests.values import now

EDGE = (-1000, -100, -10, -2, -1, 0, 1, 2, 10, 100, 1000)


def test_boots_silent_and_obeys_nothing(nodes: HostNodes) -> None:
    guard = Guard(nodes, enable=True, velocity=100_000)
    for _ in range(500):
        assert guard.tick() == 0
        assert guard.state is DriveState.SILENT
    assert guard.faults == DriveFault.NONE


def test_the_host_tells_people_the_age_at_which_the_drive_stops(nodes: HostNodes) -> None:
    assert nodes.lib.nr_drive_defaults.guard.command_age_us == round(COMMAND_AGE_S * 1e6)
    assert "for 50 ms;" in DRIVE_SENTENCES[DriveFault.COMMAND_AGE]


def test_first_command_after_boot_only_sets_the_counter(nodes: HostNodes) -> None:
    guard = Guard(nodes)
    assert not guard.say(counter=0)
    assert guard.say(counter=1)


@pytest.mark.parametrize("step", range(16))
def test_counter_must_move_on_by_one_to_three(nodes: HostNodes, step: int) -> None:
    for start in range(16):
        guard = Guard(nodes)
        guard.say(counter=start)
        assert guard.say(counter=(start + step) % 16) == (1 <= step <= 3)


@pytest.mark.parametrize("beats", [0, 1, 2, 3, 4, 100, 32_768, 65_533, 65_535])
def test_heartbeat_must_move_on_by_none_to_three(nodes: HostNodes, beats: int) -> None:
    for start in (0, 65_534):
        guard = Guard(nodes, heartbeat=start, host_thinks=False)
        guard.say()
        guard.heartbeat = (start + beats) % 65_536
        assert guard.say() == (beats <= 3)


@pytest.mark.parametrize("quiet_us", [19_999, 20_000, 20_001])
def test_a_sequence_is_taken_up_anew_once_the_last_is_old_but_its_first_frame_is_not_obeyed(
    nodes: HostNodes, quiet_us: int
) -> None:
    guard = Guard(nodes)
    guard.say(counter=0)
    assert guard.say(counter=1)
    guard.now_us += quiet_us
    assert not guard.say(counter=9)
    assert guard.say(counter=10) == (quiet_us > 20_000)


def test_frame_with_a_wrong_counter_gives_nothing(nodes: HostNodes) -> None:
    guard = Guard(nodes).ready()
    guard.host_alive = False
    guard.enable, guard.velocity = True, 100_000
    assert not guard.say(counter=(guard.counter + 8) % 16)
    assert guard.tick() == 0
    assert not guard.c.command.enable


def test_clear_needs_no_enable_no_velocity_and_a_fresh_bit(nodes: HostNodes) -> None:
    for enable, velocity in ((True, 0), (False, 1), (False, -1), (True, 1000)):
        guard = Guard(nodes)
        guard.tick(10)
        guard.clear, guard.enable, guard.velocity = True, enable, velocity
        guard.tick(100)
        assert guard.state is DriveState.SILENT


def test_a_stuck_clear_bit_clears_nothing_twice(nodes: HostNodes) -> None:
    guard = Guard(nodes).ready()
    guard.clear = True
    guard.tick(10)
    guard.host_alive = False
    guard.tick(60)
    assert now(guard.state) is DriveState.SILENT
    guard.host_alive = True
    guard.tick(200)
    assert now(guard.state) is DriveState.SILENT
    guard.clear = False
    guard.tick(10)
    guard.clear = True
    guard.tick(10)
    assert guard.state is DriveState.READY


def test_a_clear_stands_until_its_cause_is_gone_and_falls_with_its_bit(nodes: HostNodes) -> None:
    guard = Guard(nodes, torque_alive=False)
    guard.tick(10)
    guard.clear = True
    guard.tick(20)
    assert now(guard.state) is DriveState.SILENT
    guard.torque_alive = True
    guard.tick(2)
    assert guard.state is DriveState.READY

    other = Guard(nodes, torque_alive=False)
    other.tick(10)
    other.clear = True
    other.tick(20)
    other.clear = False
    other.tick(10)
    other.torque_alive = True
    other.tick(100)
    assert other.state is DriveState.SILENT


def test_host_that_leaves_a_standing_drive_must_ask_again(nodes: HostNodes) -> None:
    guard = Guard(nodes).ready()
    guard.host_alive = False
    guard.tick(45)
    assert now(guard.state) is DriveState.READY
    guard.tick(15)
    assert guard.state is DriveState.SILENT
    assert guard.faults == DriveFault.NONE
    guard.host_alive, guard.enable, guard.velocity = True, True, 100_000
    assert guard.tick(100) == 0


def test_standing_drive_waits_for_its_torque_node(nodes: HostNodes) -> None:
    guard = Guard(nodes).ready()
    guard.torque_alive = False
    guard.tick(500)
    assert guard.state is DriveState.READY
    guard.enable, guard.velocity = True, 100_000
    assert guard.tick(10) == 0
    assert guard.faults == DriveFault.TORQUE_AGE


def test_running_and_back(nodes: HostNodes) -> None:
    guard = Guard(nodes).running(123_456)
    assert guard.permitted == 123_456
    guard.velocity = -4321
    guard.tick(5)
    assert guard.permitted == -4321
    guard.enable = False
    assert guard.tick(5) == 0
    assert guard.state is DriveState.READY


def test_stops_within_the_command_age(nodes: HostNodes) -> None:
    guard = Guard(nodes).running()
    guard.host_alive = False
    last_us = guard.c.command_us
    while guard.state is DriveState.RUNNING:
        guard.tick()
    late_us = guard.now_us - last_us
    assert 50_000 < late_us <= 51_000
    assert guard.permitted == 0
    assert guard.faults == DriveFault.COMMAND_AGE


@pytest.mark.parametrize("offset_us", EDGE)
def test_command_age_edge(nodes: HostNodes, offset_us: int) -> None:
    guard = Guard(nodes).running()
    guard.jump(guard.c.command_us + guard.limits.command_age_us + offset_us - guard.c.step_us)
    guard.c.torque_us = guard.now_us % 2**32
    assert (guard.step() == 0) == (offset_us > 0)


@pytest.mark.parametrize("offset_us", EDGE)
def test_heartbeat_edge(nodes: HostNodes, offset_us: int) -> None:
    guard = Guard(nodes).running()
    guard.host_thinks = False
    guard.jump(guard.c.heartbeat_us + guard.limits.heartbeat_us + offset_us - guard.c.step_us)
    guard.c.torque_us = guard.now_us % 2**32
    guard.say()
    stopped = guard.step() == 0
    assert stopped == (offset_us > 0)
    assert guard.faults == (DriveFault.HEARTBEAT if stopped else DriveFault.NONE)


@pytest.mark.parametrize("offset_us", EDGE)
def test_torque_age_edge(nodes: HostNodes, offset_us: int) -> None:
    guard = Guard(nodes).running()
    guard.jump(guard.c.torque_us + guard.limits.torque_age_us + offset_us - guard.c.step_us)
    guard.say()
    stopped = guard.step() == 0
    assert stopped == (offset_us > 0)
    assert guard.faults == (DriveFault.TORQUE_AGE if stopped else DriveFault.NONE)


def test_torque_node_that_doubts_its_sensor_is_as_good_as_quiet(nodes: HostNodes) -> None:
    guard = Guard(nodes).running()
    guard.torque_good = False
    guard.tick(60)
    assert guard.faults == DriveFault.TORQUE_AGE


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("offset", EDGE)
def test_torque_trip_edge(nodes: HostNodes, sign: int, offset: int) -> None:
    guard = Guard(nodes).running()
    guard.torque = sign * (guard.limits.torque_trip + offset)
    guard.tick()
    assert guard.faults == (DriveFault.TORQUE_TRIP if offset > 0 else DriveFault.NONE)


@pytest.mark.parametrize("torque", [-(2**31), 2**31 - 1])
def test_torque_at_the_ends_of_its_range_trips(nodes: HostNodes, torque: int) -> None:
    guard = Guard(nodes).running()
    guard.torque = torque
    assert guard.tick() == 0
    assert guard.faults == DriveFault.TORQUE_TRIP


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("offset", EDGE)
def test_velocity_command_edge(nodes: HostNodes, sign: int, offset: int) -> None:
    guard = Guard(nodes).running()
    guard.velocity = sign * (guard.limits.velocity_limit + offset)
    guard.say()
    permitted = guard.step()
    assert permitted == (0 if offset > 0 else guard.velocity)
    assert guard.faults == (DriveFault.VELOCITY if offset > 0 else DriveFault.NONE)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("offset_mdeg", [-1000, -1, 0, 1, 1000])
def test_angle_limit_holds_outward_commands(nodes: HostNodes, sign: int, offset_mdeg: int) -> None:
    guard = Guard(nodes, angle_mdeg=sign * (720_000.0 + offset_mdeg), follows=0.0).ready()
    guard.enable, guard.velocity = True, sign * 1000
    assert guard.tick(10) == (0 if offset_mdeg >= 0 else sign * 1000)
    guard.velocity = -sign * 1000
    assert guard.tick(10) == -sign * 1000
    assert guard.faults == DriveFault.NONE


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("offset_mdeg", EDGE)
def test_angle_fault_edge_and_the_way_back(nodes: HostNodes, sign: int, offset_mdeg: int) -> None:
    guard = Guard(nodes, angle_mdeg=sign * (722_000.0 + offset_mdeg), follows=0.0).ready()
    guard.enable, guard.velocity = True, sign * 1000
    guard.tick(10)
    assert guard.faults == (DriveFault.ANGLE if offset_mdeg > 0 else DriveFault.NONE)
    guard.clear_now()
    guard.tick(100)
    guard.clear_now()
    assert guard.state is DriveState.READY
    guard.enable, guard.velocity = True, -sign * 1000
    assert guard.tick(10) == -sign * 1000


def test_encoder_error_stops(nodes: HostNodes) -> None:
    guard = Guard(nodes).running()
    guard.encoder_good = False
    assert guard.tick() == 0
    assert guard.faults == DriveFault.ENCODER


@pytest.mark.parametrize("count", range(8, 14))
def test_damaged_frames_edge(nodes: HostNodes, count: int) -> None:
    guard = Guard(nodes).running()
    guard.c.window_start_us = guard.now_us
    for _ in range(count):
        guard.lib.nr_guard_bad_frame(guard.c)
    guard.tick()
    assert guard.faults == (DriveFault.FRAME if count > 10 else DriveFault.NONE)
    guard.tick(50)
    assert guard.c.bad_frames == 0 or guard.state is DriveState.FAULT


def test_damaged_frames_do_not_wrap(nodes: HostNodes) -> None:
    guard = Guard(nodes)
    for _ in range(2**16 + 5):
        guard.lib.nr_guard_bad_frame(guard.c)
    assert guard.c.bad_frames == 2**16 - 1


def _break_command_age(guard: Guard) -> None:
    guard.host_alive = False


def _break_heartbeat(guard: Guard) -> None:
    guard.host_thinks = False


def _break_velocity(guard: Guard) -> None:
    guard.velocity = 900_001


def _break_angle(guard: Guard) -> None:
    guard.c.config.angle_limit_mdeg = -3_000
    guard.angle_mdeg = abs(guard.angle_mdeg)


def _break_torque(guard: Guard) -> None:
    guard.torque = 200_001


def _break_encoder(guard: Guard) -> None:
    guard.encoder_good = False


def _break_torque_age(guard: Guard) -> None:
    guard.torque_alive = False


def _break_frames(guard: Guard) -> None:
    for _ in range(40):
        guard.lib.nr_guard_bad_frame(guard.c)


def _break_stall(guard: Guard) -> None:
    guard.follows = 0.0


def _break_runaway(guard: Guard) -> None:
    guard.follows = 2.0


def _break_direction(guard: Guard) -> None:
    guard.follows = -1.0


def _break_master(guard: Guard) -> None:
    for _ in range(4):
        guard.say(counter=(guard.counter + 8) % 16)


def _break_emergency_stop(guard: Guard) -> None:
    guard.emergency_stop = True


BREAKS: dict[DriveFault, Callable[[Guard], None]] = {
    DriveFault.COMMAND_AGE: _break_command_age,
    DriveFault.HEARTBEAT: _break_heartbeat,
    DriveFault.VELOCITY: _break_velocity,
    DriveFault.ANGLE: _break_angle,
    DriveFault.TORQUE_TRIP: _break_torque,
    DriveFault.ENCODER: _break_encoder,
    DriveFault.TORQUE_AGE: _break_torque_age,
    DriveFault.FRAME: _break_frames,
    DriveFault.STALL: _break_stall,
    DriveFault.RUNAWAY: _break_runaway,
    DriveFault.DIRECTION: _break_direction,
    DriveFault.MASTER: _break_master,
    DriveFault.EMERGENCY_STOP: _break_emergency_stop,
}


def _mend(guard: Guard) -> None:
    guard.host_alive = guard.host_thinks = guard.torque_alive = guard.encoder_good = True
    guard.emergency_stop, guard.follows = False, 1.0
    guard.torque, guard.velocity = 0, 0
    guard.c.config.angle_limit_mdeg = 720_000


@pytest.mark.parametrize("reason", list(BREAKS))
def test_every_fault_is_entered_held_and_left(nodes: HostNodes, reason: DriveFault) -> None:
    guard = Guard(nodes).running()
    assert guard.c.supply
    BREAKS[reason](guard)
    for _ in range(200):
        guard.tick()
        assert guard.c.supply == (guard.state is DriveState.RUNNING), "the supply opens in the same tick"
    assert now(guard.faults) == reason
    assert now(guard.state) is DriveState.FAULT
    _mend(guard)
    guard.enable, guard.velocity = True, 100_000
    assert guard.tick(200) == 0, "a fault does not end by itself"
    assert now(guard.faults) == reason
    assert not guard.c.supply
    guard.clear_now()
    assert guard.state is DriveState.READY
    assert guard.faults == DriveFault.NONE
    guard.enable, guard.velocity = True, 100_000
    guard.tick(30)
    assert guard.permitted == 100_000


# Forgiven by a clear: what is over by then, and a shaft out of range, which may turn back in.
OVER = (
    DriveFault.VELOCITY | DriveFault.FRAME | DriveFault.ANGLE | DriveFault.STALL | DriveFault.RUNAWAY
    | DriveFault.DIRECTION | DriveFault.MASTER
)  # fmt: skip
LASTING = [fault for fault in BREAKS if fault not in OVER]


@pytest.mark.parametrize("reason", LASTING)
def test_no_clear_while_the_cause_lasts(nodes: HostNodes, reason: DriveFault) -> None:
    guard = Guard(nodes).running()
    BREAKS[reason](guard)
    guard.tick(60)
    guard.clear_now()
    guard.tick(200)
    assert guard.state is DriveState.FAULT


def test_latching_faults_want_stillness_temporary_ones_do_not(nodes: HostNodes) -> None:
    for reason, latching in ((DriveFault.TORQUE_TRIP, True), (DriveFault.FRAME, False)):
        guard = Guard(nodes).running()
        BREAKS[reason](guard)
        guard.tick(1)
        assert guard.faults == reason
        _mend(guard)
        guard.enable = False
        guard.tick(5)
        guard.clear = True
        guard.tick(5)
        assert (guard.state is DriveState.FAULT) == latching
        guard.clear = False
        guard.tick(100)
        guard.angle_mdeg += 11
        guard.clear = True
        guard.tick(98)
        assert (guard.state is DriveState.FAULT) == latching
        guard.tick(3)
        assert guard.state is DriveState.READY


def fresh(guard: Guard) -> None:
    """Links alive now, whatever the clock says."""
    guard.c.command_us = guard.c.heartbeat_us = guard.c.torque_us = guard.now_us % 2**32


@pytest.mark.parametrize("sign", [-1, 1])
def test_out_of_range_only_a_real_turn_inward_is_no_fault(nodes: HostNodes, sign: int) -> None:
    for velocity, faults in ((0, DriveFault.ANGLE), (-sign, DriveFault.NONE), (sign, DriveFault.ANGLE)):
        guard = Guard(nodes, angle_mdeg=sign * 723_000.0, follows=0.0).ready()
        guard.enable, guard.velocity = True, velocity
        guard.tick(10)
        assert guard.faults == faults


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_slowest_command_outward_is_held_at_the_limit(nodes: HostNodes, sign: int) -> None:
    guard = Guard(nodes, angle_mdeg=sign * 720_500.0, follows=0.0).ready()
    guard.enable, guard.velocity = True, sign
    assert guard.tick(10) == 0
    assert guard.state is DriveState.RUNNING


@pytest.mark.parametrize(
    "reasons",
    [
        (DriveFault.COMMAND_AGE, DriveFault.TORQUE_AGE),
        (DriveFault.HEARTBEAT, DriveFault.TORQUE_TRIP),
        (DriveFault.TORQUE_TRIP, DriveFault.VELOCITY),
        (DriveFault.VELOCITY, DriveFault.ENCODER),
        (DriveFault.VELOCITY, DriveFault.ANGLE),
        (DriveFault.ENCODER, DriveFault.FRAME),
        (DriveFault.FRAME, DriveFault.MASTER),
        (DriveFault.MASTER, DriveFault.EMERGENCY_STOP),
    ],
)
def test_causes_that_come_together_are_all_named(
    nodes: HostNodes, reasons: tuple[DriveFault, DriveFault]
) -> None:
    guard = Guard(nodes).running()
    for reason in reasons:
        BREAKS[reason](guard)
    if DriveFault.HEARTBEAT in reasons:
        guard.jump(50_001 + guard.c.heartbeat_us - guard.c.step_us)
        guard.host_thinks = False
        guard.say()
        guard.lib.nr_guard_torque(guard.c, guard.now_us, guard.torque, True)
    elif DriveFault.COMMAND_AGE in reasons:
        guard.jump(60_000)
    else:
        if DriveFault.ANGLE in reasons:
            guard.angle_mdeg = 1.0
        guard.say()
        guard.lib.nr_guard_torque(guard.c, guard.now_us, guard.torque, True)
    guard.c.window_open = True
    guard.c.window_start_us = guard.now_us
    guard.step()
    assert guard.faults == reasons[0] | reasons[1]


@pytest.mark.parametrize("short_us", [1, 0])
def test_stillness_edge(nodes: HostNodes, short_us: int) -> None:
    guard = Guard(nodes).running()
    guard.torque = 200_001
    guard.tick()
    assert guard.state is DriveState.FAULT
    guard.torque, guard.enable, guard.velocity = 0, False, 0
    guard.say()
    guard.clear = True
    guard.now_us = guard.c.still_since_us + guard.limits.latch_us - short_us
    guard.c.sequence_us = guard.now_us
    guard.say()
    fresh(guard)
    guard.c.torque = 0
    guard.step()
    assert guard.state is (DriveState.FAULT if short_us else DriveState.READY)


def test_a_clear_forgives_damaged_frames_to_the_last(nodes: HostNodes) -> None:
    guard = Guard(nodes).running()
    guard.step()
    _break_frames(guard)
    guard.step()
    assert now(guard.faults) == DriveFault.FRAME
    guard.enable, guard.velocity = False, 0
    guard.say()
    guard.clear = True
    guard.say()
    guard.step()
    assert guard.state is DriveState.READY
    guard.clear, guard.enable = False, True
    guard.say()
    for _ in range(10):
        guard.lib.nr_guard_bad_frame(guard.c)
    guard.step()
    assert guard.faults == DriveFault.NONE


def test_clock_may_wrap_anywhere(nodes: HostNodes) -> None:
    for before_ms in range(0, 260, 7):
        guard = Guard(nodes, now_us=2**32 - before_ms * 1000).running()
        assert guard.tick(300) == 100_000


@settings(max_examples=3 * settings().max_examples)
@given(
    st.lists(
        st.tuples(
            st.integers(-(2**31), 2**31 - 1),
            st.booleans(),
            st.booleans(),
            st.integers(0, 15),
            st.integers(0, 65535),
            st.integers(-(2**31), 2**31 - 1),
            st.integers(-(2**31), 2**31 - 1),
            st.booleans(),
            st.integers(0, 200_000),
        ),
        max_size=60,
    )
)
def test_whatever_comes_the_motor_turns_only_when_running_and_within_limits(
    nodes: HostNodes, steps: list[tuple[int, bool, bool, int, int, int, int, bool, int]]
) -> None:
    guard = Guard(nodes).running()
    for velocity, enable, clear, counter, heartbeat, torque, angle, encoder_good, elapsed_us in steps:
        guard.now_us += elapsed_us
        guard.velocity, guard.enable, guard.clear, guard.heartbeat = velocity, enable, clear, heartbeat
        guard.say(counter=counter)
        guard.lib.nr_guard_torque(guard.c, guard.now_us % 2**32, torque, True)
        guard.angle_mdeg, guard.encoder_good = angle, encoder_good
        permitted = guard.step()
        if permitted:
            assert guard.state is DriveState.RUNNING
            assert abs(permitted) <= guard.limits.velocity_limit
            assert guard.c.command.enable
            assert encoder_good
            assert abs(torque) <= guard.limits.torque_trip
            assert abs(angle) < 720_000 or permitted * angle < 0
        else:
            assert guard.faults == DriveFault.NONE or guard.state is DriveState.FAULT
