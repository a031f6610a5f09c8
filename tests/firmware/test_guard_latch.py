"""What latches in the drive node stays until a clear that a person acknowledged, whatever else is wrong."""

from __future__ import annotations

import pytest

from needle_rig.firmware.host import HostNodes
from needle_rig.records import TEMPORARY, DriveFault, DriveState
from tests.firmware.harness import Guard
from tests.values import now

LATCH_MS = 100


def broken(guard: Guard, fault: DriveFault) -> None:
    """Let the cause of `fault` come."""
    if fault is DriveFault.EMERGENCY_STOP:
        guard.emergency_stop = True
    elif fault is DriveFault.TORQUE_TRIP:
        guard.torque = 200_001
    elif fault is DriveFault.ENCODER:
        guard.encoder_good = False
    else:
        guard.host_thinks = False


def mended(guard: Guard) -> None:
    guard.emergency_stop, guard.torque, guard.encoder_good, guard.host_thinks = False, 0, True, True


LATCHING = (
    DriveFault.EMERGENCY_STOP,
    DriveFault.TORQUE_TRIP,
    DriveFault.ENCODER,
    DriveFault.HEARTBEAT,
)


def in_a_temporary_fault(nodes: HostNodes) -> Guard:
    guard = Guard(nodes).running()
    guard.enable, guard.velocity = False, 0
    guard.tick(10)
    guard.enable, guard.velocity, guard.torque_alive = True, 100_000, False
    guard.tick(60)
    assert (guard.state, guard.faults) == (DriveState.FAULT, DriveFault.TORQUE_AGE)
    guard.enable, guard.velocity, guard.torque_alive = False, 0, True
    guard.tick(10)
    return guard


@pytest.mark.parametrize("fault", LATCHING, ids=str)
def test_a_latching_cause_is_added_to_a_fault_that_stands(nodes: HostNodes, fault: DriveFault) -> None:
    guard = in_a_temporary_fault(nodes)
    broken(guard, fault)
    guard.tick(60)
    mended(guard)
    guard.tick(10)
    assert guard.faults == DriveFault.TORQUE_AGE | fault
    guard.acknowledge = False
    for _ in range(20):
        guard.tick(50)
        guard.clear_now()
    assert now(guard.state) is DriveState.FAULT
    assert not guard.c.supply
    guard.acknowledge = True
    guard.clear_now()
    assert (guard.state, guard.faults) == (DriveState.READY, DriveFault.NONE)


def test_a_temporary_fault_needs_no_acknowledgement(nodes: HostNodes) -> None:
    guard = in_a_temporary_fault(nodes)
    guard.acknowledge = False
    guard.clear_now()
    assert guard.state is DriveState.READY
    assert TEMPORARY & DriveFault.TORQUE_AGE


@pytest.mark.parametrize("state", ["silent", "ready", "running", "fault"])
def test_an_emergency_stop_latches_from_every_state_however_short(nodes: HostNodes, state: str) -> None:
    guard = Guard(nodes)
    guard.tick(10)
    if state != "silent":
        guard = {"ready": guard.ready, "running": guard.running}.get(state, lambda: guard)()
    if state == "fault":
        guard = in_a_temporary_fault(nodes)
    guard.emergency_stop = True
    guard.tick(1)
    guard.emergency_stop = False
    guard.enable, guard.velocity = False, 0
    guard.tick(10)
    assert now(guard.state) is DriveState.FAULT
    assert guard.faults & DriveFault.EMERGENCY_STOP
    guard.acknowledge = False
    guard.tick(LATCH_MS)
    guard.clear_now()
    assert now(guard.state) is DriveState.FAULT


@pytest.mark.parametrize(("after_ms", "granted"), [(96, False), (104, True)])
def test_a_clear_that_was_on_its_way_clears_nothing_new(
    nodes: HostNodes, after_ms: int, granted: bool
) -> None:
    """A person cleared one fault; the emergency stop was pressed and released before his clear arrived."""
    guard = in_a_temporary_fault(nodes)
    guard.tick(200)
    guard.emergency_stop = True
    guard.tick(1)
    guard.emergency_stop = False
    guard.tick(after_ms - 1)
    guard.clear = True
    guard.say()
    for _ in range(300):
        guard.tick(1)
    assert (guard.state is DriveState.READY) == granted


def test_a_clear_that_stood_before_is_forgotten_with_the_new_cause(nodes: HostNodes) -> None:
    guard = in_a_temporary_fault(nodes)
    guard.torque_alive = False
    guard.tick(60)
    guard.clear = True
    guard.tick(10)
    assert now(guard.state) is DriveState.FAULT, "the torque node is still quiet: the clear waits"
    guard.emergency_stop = True
    guard.tick(1)
    guard.emergency_stop, guard.torque_alive = False, True
    guard.tick(400)
    assert guard.state is DriveState.FAULT


def test_a_shaft_out_of_range_can_still_be_cleared(nodes: HostNodes) -> None:
    guard = Guard(nodes, angle_mdeg=723_000.0, follows=0.0).ready()
    guard.enable, guard.velocity = True, 1
    guard.tick(10)
    assert (guard.state, guard.faults) == (DriveState.FAULT, DriveFault.ANGLE)
    guard.enable, guard.velocity = False, 0
    guard.tick(LATCH_MS)
    guard.clear_now()
    assert guard.state is DriveState.READY


def test_a_latch_is_cleared_also_when_the_counter_of_the_node_has_wrapped(nodes: HostNodes) -> None:
    guard = in_a_temporary_fault(nodes)
    guard.emergency_stop = True
    guard.tick(1)
    guard.emergency_stop = False
    guard.now_us += 2**31
    guard.tick(LATCH_MS)
    guard.clear_now()
    guard.clear_now()
    assert guard.state is DriveState.READY


@pytest.mark.parametrize(("seen_ms_ago", "granted"), [(195, True), (211, False)])
def test_a_clear_that_is_repeated_clears_no_cause_that_came_after_its_sight(
    nodes: HostNodes, seen_ms_ago: int, granted: bool
) -> None:
    """The emergency stop comes again, as a contact that bounces, while a clear goes out again and again."""
    guard = in_a_temporary_fault(nodes)
    guard.emergency_stop = True
    guard.tick(300)
    guard.emergency_stop = False
    guard.tick(300)
    for sight_ms in range(seen_ms_ago, seen_ms_ago + 1000, 20):
        guard.sight_us = sight_ms * 1000
        guard.clear = True
        guard.tick(10)
        guard.clear = False
        guard.tick(10)
    assert (guard.state is DriveState.READY) == granted


@pytest.mark.parametrize(("seen_ms_ago", "granted"), [(90, True), (115, False)])
def test_a_fault_that_was_there_for_a_moment_wants_a_sight_of_its_own(
    nodes: HostNodes, seen_ms_ago: int, granted: bool
) -> None:
    """A motor that stalls is found once: nothing shows it again after the supply is off."""
    guard = Guard(nodes).running()
    guard.follows = 0.0
    while guard.state is DriveState.RUNNING:
        guard.tick()
    assert guard.faults == DriveFault.STALL
    guard.enable, guard.velocity = False, 0
    guard.tick(200)
    guard.sight_us = seen_ms_ago * 1000
    guard.clear_now()
    assert (guard.state is DriveState.READY) == granted
