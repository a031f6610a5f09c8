"""The guard's supply, emergency stop, masters and reference: each limit around its edge."""

from __future__ import annotations

import pytest

from needle_rig.firmware.host import HostNodes
from needle_rig.records import DriveFault, DriveState
from tests.firmware.harness import Guard
from tests.values import now


def foreign(guard: Guard) -> bool:
    """A command with another master's counter."""
    thinks, guard.host_thinks = guard.host_thinks, False
    taken = guard.say(counter=(guard.counter + 8) % 16)
    guard.host_thinks = thinks
    return taken


@pytest.mark.parametrize("early_us", [-1000, -1, 0, 1, 1000])
def test_nothing_turns_before_the_contact_has_closed(nodes: HostNodes, early_us: int) -> None:
    guard = Guard(nodes)
    guard.tick(10)
    guard.clear_now()
    closed_us = guard.c.supply_us
    guard.enable, guard.velocity = True, 100_000
    guard.jump(closed_us + guard.limits.contact_us - early_us - guard.c.step_us)
    guard.say()
    guard.lib.nr_guard_torque(guard.c, guard.now_us, 0, True)
    assert guard.step() == (0 if early_us > 0 else 100_000)
    assert guard.state is (DriveState.READY if early_us > 0 else DriveState.RUNNING)
    assert guard.c.supply


def test_the_contact_stays_closed_from_motion_to_motion(nodes: HostNodes) -> None:
    guard = Guard(nodes).running()
    guard.enable = False
    guard.tick(5)
    assert (guard.state, bool(guard.c.supply)) == (DriveState.READY, True)
    guard.enable = True
    assert guard.tick(5) == 100_000


def test_the_supply_is_off_in_silent_and_when_the_host_leaves(nodes: HostNodes) -> None:
    guard = Guard(nodes)
    guard.tick(30)
    assert not guard.c.supply
    guard.ready()
    assert guard.c.supply
    guard.host_alive = False
    guard.tick(60)
    assert (guard.state, bool(guard.c.supply)) == (DriveState.SILENT, False)


def test_the_emergency_stop_ends_ready_too_and_holds_off_every_clear(nodes: HostNodes) -> None:
    guard = Guard(nodes, emergency_stop=True)
    guard.tick(10)
    guard.clear_now()
    assert (now(guard.state), guard.faults) == (DriveState.FAULT, DriveFault.EMERGENCY_STOP)
    guard.emergency_stop = False
    guard.tick(100)
    guard.clear_now()
    assert now(guard.state) is DriveState.READY
    guard.emergency_stop = True
    guard.tick()
    assert (guard.state, guard.faults) == (DriveState.FAULT, DriveFault.EMERGENCY_STOP)
    assert not guard.c.supply
    guard.tick(200)
    guard.clear_now()
    assert now(guard.state) is DriveState.FAULT
    guard.emergency_stop = False
    guard.tick(100)
    guard.clear_now()
    assert guard.state is DriveState.READY


@pytest.mark.parametrize("commands", [1, 2, 3, 4, 5, 100])
def test_so_many_commands_out_of_sequence_are_another_master(nodes: HostNodes, commands: int) -> None:
    guard = Guard(nodes).running()
    guard.velocity = 300_000
    for _ in range(commands):
        assert not foreign(guard)
    guard.velocity = 100_000
    assert guard.step() == (100_000 if commands <= 3 else 0)
    assert guard.faults == (DriveFault.NONE if commands <= 3 else DriveFault.MASTER)


@pytest.mark.parametrize("wait_ms", [49, 50, 51])
def test_a_command_out_of_sequence_is_forgotten_after_a_while(nodes: HostNodes, wait_ms: int) -> None:
    guard = Guard(nodes).running()
    for _ in range(3):
        foreign(guard)
    guard.tick(wait_ms)
    foreign(guard)
    guard.step()
    assert guard.faults == (DriveFault.NONE if wait_ms >= 50 else DriveFault.MASTER)


def test_a_frame_that_the_bus_repeats_is_nobody_else(nodes: HostNodes) -> None:
    guard = Guard(nodes).running()
    guard.tick(5)
    for _ in range(50):
        guard.host_thinks = False
        assert not guard.say(counter=guard.counter)
        guard.host_thinks = True
        guard.tick()
    assert guard.state is DriveState.RUNNING
    assert guard.c.foreign_us == 0


@pytest.mark.parametrize("change", ["velocity", "enable", "clear", "acknowledge", "sight_us", "heartbeat"])
def test_a_repeat_that_says_something_else_is_counted(nodes: HostNodes, change: str) -> None:
    guard = Guard(nodes, host_thinks=False, clear=True).running()
    changed = {
        "velocity": 1,
        "enable": False,
        "clear": False,
        "acknowledge": False,
        "sight_us": 5000,
        "heartbeat": guard.heartbeat + 1,
    }
    guard.clear = True
    guard.say()
    setattr(guard, change, changed[change])
    assert not guard.say(counter=guard.counter)
    assert guard.c.foreign_us == guard.limits.foreign_us


def test_a_master_that_follows_the_counter_is_noticed_within_40_ms(nodes: HostNodes) -> None:
    for period_ms in (1, 2, 5):
        guard = Guard(nodes).running()
        guard.host_alive = False
        passed_ms = 0
        while guard.state is DriveState.RUNNING:
            guard.tick()
            passed_ms += 1
            if passed_ms % period_ms == 0:
                guard.velocity = 100_000
                guard.say()
                guard.velocity, before = 600_000, guard.counter
                guard.say()
                guard.counter = before
                guard.heartbeat -= 1
            assert passed_ms <= 40
        assert guard.faults == DriveFault.MASTER


def test_many_foreign_commands_do_not_wrap_and_are_forgotten_soon(nodes: HostNodes) -> None:
    guard = Guard(nodes).running()
    for _ in range(100_000):
        foreign(guard)
    guard.tick()
    assert guard.faults == DriveFault.MASTER
    guard.tick(200)
    guard.clear_now()
    assert guard.state is DriveState.READY


def test_a_clear_waits_for_the_other_master_to_be_gone(nodes: HostNodes) -> None:
    guard = Guard(nodes).running()
    for _ in range(4):
        foreign(guard)
    guard.tick()
    guard.enable, guard.velocity, guard.clear = False, 0, True
    for _ in range(150):
        guard.tick()
        foreign(guard)
    assert now(guard.state) is DriveState.FAULT
    guard.tick(160)
    assert now(guard.state) is DriveState.FAULT, "that clear was asked for while the cause was there"
    guard.clear = False
    guard.tick(10)
    guard.clear_now()
    assert guard.state is DriveState.READY


def refer(guard: Guard, angle_mdeg: int, beat: int = 0) -> bool:
    """A reference with the heartbeat of the newest command, or one near it."""
    heartbeat = (guard.c.command.heartbeat + beat) % 65_536
    return bool(guard.lib.nr_guard_reference(guard.c, guard.now_us % 2**32, heartbeat, angle_mdeg))


@pytest.mark.parametrize("beat", [-1, 0, 1])
def test_a_reference_is_taken_from_one_who_knows_the_heartbeat(nodes: HostNodes, beat: int) -> None:
    guard = Guard(nodes).ready()
    guard.tick(100)
    assert not guard.c.referenced
    assert refer(guard, 45_000, beat) == (beat == 0)
    assert guard.c.referenced == (beat == 0)


def test_a_reference_moves_nothing_and_is_no_motion(nodes: HostNodes) -> None:
    guard = Guard(nodes).ready()
    guard.tick(100)
    assert refer(guard, 45_000)
    guard.angle_mdeg = 45_000
    guard.tick(50)
    assert refer(guard, 46_000), "the shaft stood still all the time"
    guard.angle_mdeg = 46_000
    guard.tick(300)
    assert guard.state is DriveState.READY
    assert refer(guard, -3_000), "the shaft stood still meanwhile"


def test_no_reference_before_a_command_while_running_or_to_an_old_one(nodes: HostNodes) -> None:
    assert not refer(Guard(nodes), 1)
    guard = Guard(nodes, follows=0.0).running(0)
    guard.tick(300)
    assert not refer(guard, 1)
    guard.enable = False
    guard.tick(5)
    assert refer(guard, 1)
    for age_us, taken in ((50_000, True), (50_001, False)):
        guard.now_us = guard.c.command_us + age_us
        assert refer(guard, 1) == taken


def test_no_reference_for_a_shaft_that_moves(nodes: HostNodes) -> None:
    guard = Guard(nodes)
    guard.tick(200)
    for step_mdeg, taken in ((9, True), (10, True), (-10, True), (11, False), (-11, False)):
        guard.angle_mdeg += step_mdeg
        guard.tick()
        assert refer(guard, round(guard.angle_mdeg)) == taken
        guard.tick(100 - (not taken) * 2)
        assert refer(guard, round(guard.angle_mdeg)) == taken
        guard.tick(3)
        assert refer(guard, round(guard.angle_mdeg))


def fresh_window(guard: Guard) -> Guard:
    """Pass time until a new window for damaged frames begins."""
    for _ in range(50):
        guard.tick()
        if guard.c.window_start_us == guard.c.step_us:
            return guard
    raise AssertionError("no window began in 50 ms")


def damage(guard: Guard, frames: int) -> None:
    for _ in range(frames):
        guard.lib.nr_guard_bad_frame(guard.c)


def test_damaged_frames_of_one_window_are_counted_together(nodes: HostNodes) -> None:
    guard = fresh_window(Guard(nodes).running(0))
    damage(guard, 6)
    guard.tick(20)
    assert now(guard.faults) == DriveFault.NONE
    damage(guard, 5)
    guard.tick()
    assert guard.faults == DriveFault.FRAME


@pytest.mark.parametrize("late_us", [-1000, -1, 0, 1, 1000])
def test_damaged_frames_of_the_window_before_are_forgotten(nodes: HostNodes, late_us: int) -> None:
    guard = fresh_window(Guard(nodes).running(0))
    damage(guard, 6)
    guard.jump(guard.limits.window_us + late_us)
    guard.say()
    guard.lib.nr_guard_torque(guard.c, guard.now_us, 0, True)
    guard.step()
    damage(guard, 5)
    guard.tick()
    assert guard.faults == (DriveFault.FRAME if late_us < 0 else DriveFault.NONE)


def test_a_shaft_that_moves_while_it_is_held_is_idle_motion(nodes: HostNodes) -> None:
    guard = Guard(nodes).running(0)
    guard.tick(200)
    for _ in range(100):
        guard.angle_mdeg += 100
        guard.tick()
    assert (guard.state, guard.faults) == (DriveState.FAULT, DriveFault.IDLE_MOTION)


def test_a_start_is_refused_at_once_while_a_sensor_is_silent(nodes: HostNodes) -> None:
    guard = Guard(nodes).ready()
    guard.torque_alive = False
    guard.tick(100)
    assert guard.state is DriveState.READY, "a shaft that nobody turns may wait for its sensors"
    guard.enable, guard.velocity = True, 100_000
    guard.say()
    assert guard.step() == 0
    assert (guard.state, guard.faults) == (DriveState.FAULT, DriveFault.TORQUE_AGE)


def test_a_trip_in_the_step_in_which_the_host_stops_counts(nodes: HostNodes) -> None:
    guard = Guard(nodes).running()
    guard.enable = False
    guard.say()
    guard.lib.nr_guard_torque(guard.c, guard.now_us, guard.limits.torque_trip + 1, True)
    guard.step()
    assert (guard.state, guard.faults) == (DriveState.FAULT, DriveFault.TORQUE_TRIP)
