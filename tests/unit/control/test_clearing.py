"""Every clear follows from an order, and acknowledges what its person had seen and nothing else."""

from __future__ import annotations

import math
from typing import Any

import pytest

from needle_rig.control.clearing import CLEAR_EVERY, ClearHandshake, awake
from needle_rig.records import COMMAND_AGE_S, Command, DriveFault, DriveState, Measurement
from tests.values import now

TICK_S = 0.005
STOPPED = DriveFault.EMERGENCY_STOP


def seen(state: DriveState = DriveState.FAULT, faults: DriveFault = STOPPED, age_s: float = 0.001) -> Any:
    return Measurement(0.0, 0.0, 0.0, (), drive_state=state, drive_faults=faults, drive_age_s=age_s)


def told(clearing: ClearHandshake, measurement: Measurement, ticks: int) -> list[Command | None]:
    commands = []
    for _ in range(ticks):
        clearing.step(measurement, TICK_S)
        commands.append(clearing.command(measurement))
    return commands


@pytest.mark.parametrize(
    ("state", "obeys"),
    [
        (DriveState.SILENT, False),
        (DriveState.READY, True),
        (DriveState.RUNNING, True),
        (DriveState.FAULT, False),
    ],
)
def test_a_drive_is_awake_when_it_obeys_velocities(state: DriveState, obeys: bool) -> None:
    assert awake(seen(state)) is obeys


def test_nothing_goes_out_that_nobody_asked_for() -> None:
    clearing = ClearHandshake()
    assert not clearing.asked
    assert told(clearing, seen(), 3 * CLEAR_EVERY) == [None] * 3 * CLEAR_EVERY
    assert not clearing.covers(seen())


def test_a_motion_wakes_the_drive_and_acknowledges_nothing() -> None:
    clearing = ClearHandshake()
    clearing.wake()
    commands = told(clearing, seen(DriveState.SILENT, DriveFault.NONE), 2 * CLEAR_EVERY)
    pause = [Command()] * (CLEAR_EVERY - 1)
    assert commands == [*pause, Command(clear=True), *pause, Command(clear=True)]


def test_a_person_s_clear_says_how_long_ago_the_drive_told_what_he_saw() -> None:
    clearing = ClearHandshake()
    clearing.acknowledge(STOPPED, 0.01)
    commands = told(clearing, seen(), 2 * CLEAR_EVERY)
    clears = [command for command in commands if command is not None and command.clear]
    assert [command.acknowledge for command in clears] == [True, True]
    assert [command.sight_s for command in clears] == pytest.approx([0.03, 0.05])
    assert clearing.asked


def test_a_motion_ordered_after_a_clear_keeps_its_acknowledgement() -> None:
    clearing = ClearHandshake()
    clearing.acknowledge(STOPPED, 0.0)
    clearing.wake()
    command = told(clearing, seen(), CLEAR_EVERY)[-1]
    assert command is not None
    assert command.acknowledge
    assert command.sight_s == pytest.approx(0.02)


def test_a_motion_ordered_after_a_clear_has_ended_acknowledges_nothing() -> None:
    clearing = ClearHandshake()
    clearing.acknowledge(STOPPED, 0.0)
    clearing.cancel()
    assert not clearing.asked
    clearing.wake()
    assert told(clearing, seen(), CLEAR_EVERY)[-1] == Command(clear=True)


@pytest.mark.parametrize(
    ("age_s", "acknowledge"), [(COMMAND_AGE_S, True), (math.nextafter(COMMAND_AGE_S, 1.0), False)]
)
def test_a_drive_that_is_not_heard_is_not_acknowledged(age_s: float, acknowledge: bool) -> None:
    clearing = ClearHandshake()
    clearing.acknowledge(STOPPED, 0.0)
    command = told(clearing, seen(age_s=age_s), CLEAR_EVERY)[-1]
    assert command is not None
    assert (command.clear, command.acknowledge) == (True, acknowledge)


@pytest.mark.parametrize(
    ("acknowledged", "faults", "covered"),
    [
        (None, DriveFault.NONE, False),
        (None, DriveFault.COMMAND_AGE, True),
        (None, STOPPED, False),
        (None, DriveFault.COMMAND_AGE | STOPPED, False),
        (STOPPED, DriveFault.NONE, True),
        (STOPPED, STOPPED, True),
        (STOPPED, DriveFault.COMMAND_AGE | STOPPED, True),
        (STOPPED, DriveFault.ENCODER | STOPPED, False),
        (DriveFault.ENCODER | STOPPED, STOPPED, True),
        (DriveFault.NONE, STOPPED, False),
    ],
)
def test_what_is_being_cleared_is_no_news(
    acknowledged: DriveFault | None, faults: DriveFault, covered: bool
) -> None:
    clearing = ClearHandshake()
    if acknowledged is None:
        clearing.wake()
    else:
        clearing.acknowledge(acknowledged, 0.0)
    assert clearing.covers(seen(faults=faults)) is covered
    clearing.cancel()
    assert not clearing.covers(seen(faults=faults))


@pytest.mark.parametrize("by", ["wake", "acknowledge"])
def test_a_clear_is_asked_for_a_second(by: str) -> None:
    clearing = ClearHandshake()
    clearing.wake() if by == "wake" else clearing.acknowledge(STOPPED, 0.0)
    told(clearing, seen(), round(1.0 / TICK_S) - 1)
    assert now(clearing).asked
    clearing.step(seen(), TICK_S + 1e-9)
    assert not now(clearing).asked
    clearing.step(seen(), TICK_S)
    assert not now(clearing).asked
    assert clearing.command(seen()) is None


@pytest.mark.parametrize(
    ("state", "faults", "done"),
    [
        (DriveState.READY, DriveFault.NONE, True),
        (DriveState.READY, STOPPED, False),
        (DriveState.SILENT, DriveFault.NONE, False),
    ],
)
def test_a_drive_that_is_awake_without_faults_ends_the_asking(
    state: DriveState, faults: DriveFault, done: bool
) -> None:
    clearing = ClearHandshake()
    clearing.acknowledge(STOPPED, 0.0)
    clearing.step(seen(state, faults), TICK_S)
    assert clearing.asked is not done


def test_a_drive_that_is_awake_is_asked_nothing() -> None:
    clearing = ClearHandshake()
    clearing.acknowledge(STOPPED, 0.0)
    clearing.step(seen(), TICK_S)
    assert clearing.command(seen(DriveState.READY)) is None
