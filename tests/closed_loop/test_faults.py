"""What can break in a simulated rig shows at its nodes, and the true base stays where it was told."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.records import STOP, Command, DriveFault, DriveState
from needle_rig.simulation.build import build_plant
from needle_rig.simulation.firmware_rig import FirmwareRig
from needle_rig.units import deg, rad
from needle_rig.wire.can_frames import DRIVE_COMMAND_ID, DRIVE_REFERENCE_ID

KINDS = ("plant", "python", "firmware")
TICK_S = 0.005


def make(kind: str) -> Any:
    config = load_rig_config(None, {"simulation.nodes": "python" if kind == "plant" else kind})
    plant = build_plant(config)
    return plant if kind == "plant" else FirmwareRig(config, plant)


def go(rig: Any, command: Command, seconds: float) -> Any:
    for _ in range(round(seconds / TICK_S)):
        rig.write(command)
        rig.advance(TICK_S)
    return rig.read()


def turning(kind: str, speed_deg_s: float = 20.0) -> Any:
    rig = make(kind)
    for command, seconds in ((STOP, 0.15), (Command(clear=True), 0.02), (STOP, 0.05)):
        go(rig, command, seconds)
    now = go(rig, Command(rad(speed_deg_s), enable=True), 0.5)
    assert (now.drive_state, now.supply_on, now.referenced) == (DriveState.RUNNING, True, False)
    assert deg(rig.true_base_rad) == pytest.approx(speed_deg_s * 0.45, rel=0.15)
    return rig


def stick(rig: Any) -> None:
    rig.faults.encoder.stuck = True


def halve(rig: Any) -> None:
    rig.faults.motor_gain = 0.1


def reverse(rig: Any) -> None:
    rig.faults.motor_gain = -1.0


def count_backwards(rig: Any) -> None:
    rig.faults.encoder.gain = -1.0


def short(rig: Any) -> None:
    rig.faults.shorted_rad_s = rad(-180.0)


def press(rig: Any) -> None:
    rig.faults.emergency_stop = True


def cut_commands(rig: Any) -> None:
    rig.links.command.fault = "silence"


def cut_torque(rig: Any) -> None:
    rig.links.torque.fault = "silence"


HARMS: dict[Callable[[Any], None], DriveFault] = {
    stick: DriveFault.STALL,
    halve: DriveFault.STALL,
    reverse: DriveFault.DIRECTION,
    count_backwards: DriveFault.DIRECTION,
    short: DriveFault.DIRECTION,
    press: DriveFault.EMERGENCY_STOP,
    cut_commands: DriveFault.COMMAND_AGE,
    cut_torque: DriveFault.TORQUE_AGE,
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("harm", HARMS)
def test_every_harm_is_named_and_the_base_stays_within_5_degrees(
    kind: str, harm: Callable[[Any], None]
) -> None:
    rig = turning(kind)
    harm(rig)
    command, start_rad = Command(rad(20.0), enable=True), rig.true_base_rad
    now = go(rig, command, 0.3)
    assert now.drive_state is DriveState.FAULT
    assert HARMS[harm] in now.drive_faults
    assert not now.supply_on
    assert now.emergency_stop == (harm is press)
    assert -5.0 < deg(rig.true_base_rad - start_rad) < 20.0 * 0.3 + 5.0
    before_rad = rig.true_base_rad
    go(rig, command, 0.5)
    assert rig.true_base_rad == pytest.approx(before_rad, abs=rad(0.01))


@pytest.mark.parametrize("kind", KINDS)
def test_a_drive_that_restarts_loses_its_zero_until_it_is_told(kind: str) -> None:
    rig = turning(kind)
    go(rig, STOP, 0.3)
    stands_rad = rig.true_base_rad
    now = go(rig, Command(reference_rad=stands_rad), TICK_S)
    now = go(rig, STOP, 0.02)
    assert now.referenced
    assert now.base_angle_rad == pytest.approx(stands_rad, abs=rad(0.02))
    rig.reset_drive()
    now = go(rig, STOP, 0.2)
    assert (now.referenced, now.drive_state) == (False, DriveState.SILENT)
    assert now.base_angle_rad == pytest.approx(0.0, abs=rad(0.02))
    go(rig, Command(reference_rad=stands_rad), TICK_S)
    now = go(rig, STOP, 0.02)
    assert now.referenced
    assert now.base_angle_rad == pytest.approx(stands_rad, abs=rad(0.02))


@pytest.mark.parametrize("kind", KINDS)
def test_the_index_mark_is_seen_where_it_is_and_follows_a_new_reference(kind: str) -> None:
    rig = turning(kind, -20.0)
    assert math.isnan(rig.read().index_rad)
    now = go(rig, Command(rad(20.0), enable=True), 1.0)
    assert deg(now.index_rad) == pytest.approx(0.0, abs=0.15)
    go(rig, STOP, 0.3)
    told_rad = rig.read().base_angle_rad + rad(30.0)
    go(rig, Command(reference_rad=told_rad), TICK_S)
    assert deg(go(rig, STOP, 0.02).index_rad) == pytest.approx(30.0, abs=0.15)


@pytest.mark.parametrize("link", ["torque", "drive", "hall"])
@pytest.mark.parametrize("fault", ["silence", "garble", "freeze"])
def test_a_link_that_fails_grows_old_and_comes_back(link: str, fault: str) -> None:
    rig = turning("firmware")
    getattr(rig.links, link).fault = fault
    now = go(rig, STOP, 0.1)
    ages_s = {name: getattr(now, f"{name}_age_s") for name in ("torque", "drive", "hall")}
    assert ages_s.pop(link) > 0.08
    assert max(ages_s.values()) < 0.02
    getattr(rig.links, link).fault = ""
    now = go(rig, STOP, 0.02)
    assert getattr(now, f"{link}_age_s") < 0.02


def test_frames_come_late_by_the_delay() -> None:
    rig = turning("firmware")
    rig.links.torque.delay_s = 0.02
    before_nm = go(rig, STOP, 0.3).torque_nm
    assert before_nm > 0.0
    assert go(rig, STOP, 0.01).torque_age_s < 0.01


def test_a_faded_magnet_and_a_jump_show_at_their_sensor_alone() -> None:
    rig = turning("firmware")
    rig.links.hall_faded.add(2)
    now = go(rig, STOP, 0.1)
    assert now.hall_age_s > 0.08
    assert now.hall_complaint.startswith("hall_3 sees a field of 0")
    rig.links.hall_faded.clear()
    before = go(rig, STOP, 0.05).hall_rad
    rig.faults.hall_reading(1).offset = rad(60.0)
    after = go(rig, STOP, 0.05).hall_rad
    moved = [deg(b - a) for a, b in zip(before, after, strict=True)]
    assert moved == pytest.approx([0.0, 60.0, 0.0, 0.0], abs=2.0)


def test_commands_of_another_master_are_counted_and_one_s_own_are_not() -> None:
    rig = turning("firmware")
    assert rig.read().foreign_commands == 0
    rig.send(DRIVE_COMMAND_ID, rig.codec.encode_command(Command(rad(60.0), enable=True), 3, 9))
    rig.send(DRIVE_REFERENCE_ID, rig.codec.encode_reference(1.0, 3, 9))
    now = go(rig, Command(rad(20.0), enable=True), 0.1)
    assert now.foreign_commands == 2
    assert (now.drive_state, now.referenced) == (DriveState.RUNNING, False)


@pytest.mark.parametrize("kind", KINDS)
def test_a_coupling_that_slips_leaves_the_needle_behind(kind: str) -> None:
    rig = turning(kind)
    rig.faults.coupling_slip = 1.0
    before = go(rig, STOP, 0.2).hall_rad
    now = go(rig, Command(rad(20.0), enable=True), 0.5)
    assert deg(now.base_angle_rad) > 15.0
    assert [deg(b - a) for a, b in zip(before, now.hall_rad, strict=True)] == pytest.approx(
        [0.0] * 4, abs=2.0
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("welded", [False, True])
def test_a_relay_that_is_welded_leaves_a_shorted_stage_its_supply(kind: str, welded: bool) -> None:
    rig = turning(kind)
    rig.faults.supply_welded = welded
    press(rig)
    assert not go(rig, STOP, 0.1).supply_on
    before_rad = rig.true_base_rad
    short(rig)
    go(rig, STOP, 0.5)
    assert (abs(deg(rig.true_base_rad - before_rad)) > 45.0) == welded
