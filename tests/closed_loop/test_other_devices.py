"""A compensation through a CiA 402 drive, an ATI sensor and lines of text, and what can break it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from needle_rig.control.brain import Brain
from needle_rig.control.compensation import ACTIVE
from needle_rig.control.faults import FaultName
from needle_rig.control.reports import Request
from needle_rig.errors import RigFault
from needle_rig.records import DriveFault, DriveState, Phase
from needle_rig.simulation.run import run_virtual
from needle_rig.units import deg, nmm, rad
from tests.closed_loop.other_devices import DRIVE, HALL, TORQUE, VirtualRig, config_of, lag_deg

TICK_S = 0.005


@pytest.mark.whole
@pytest.mark.parametrize(("mode", "backwards"), [("csv", False), ("pv", True)])
def test_a_compensation_ends_as_with_the_nodes(mode: str, backwards: bool) -> None:
    drive = DRIVE.model_copy(update={"mode": mode, "reversed": backwards})
    config = config_of(drive, TORQUE.model_copy(update={"reversed": backwards, "axis": "x"}))
    rig, brain = VirtualRig(config), Brain(config)
    run = run_virtual(brain, rig, Request(target_rad=rad(45.0)))  # type: ignore[arg-type]
    assert run.outcome.status == "not_aligned"  # as every run of Reed's sequence in this elastic tissue
    assert [motion.name for motion in run.settled] == ["rotate", "overshoot", "back", "forward", "final"]
    assert deg(rig.true_base_rad) == pytest.approx(45.0, abs=0.2)
    assert lag_deg(rig) == pytest.approx(11.5, abs=1.5)
    assert nmm(run.settled[-1].torque_nm) == pytest.approx(0.0436, abs=0.003)


def turning(rig: VirtualRig, brain: Brain) -> None:
    """The base is on its way to 60°."""
    brain.compensate(Request(target_rad=rad(60.0)))
    for _ in range(600):
        tick(rig, brain)
        if rig.true_base_rad > rad(10.0):
            return
    raise AssertionError(f"it does not turn: {brain.state}")


def tick(rig: VirtualRig, brain: Brain) -> None:
    rig.advance(TICK_S)
    command, _ = brain.step(rig.read(), TICK_S)
    rig.write(command)


def until_fault(rig: VirtualRig, brain: Brain, limit_s: float) -> tuple[float, float]:
    """Seconds until the fault, and degrees that the base turned from then until it stands."""
    ticks = 0
    while brain.state.phase in ACTIVE and ticks * TICK_S < limit_s:
        tick(rig, brain)
        ticks += 1
    assert brain.state.phase is Phase.FAULT, f"no fault within {limit_s} s: {brain.state}"
    at_rad = rig.true_base_rad
    for _ in range(60):
        tick(rig, brain)
    rest_rad = rig.true_base_rad
    for _ in range(20):
        tick(rig, brain)
    assert rig.true_base_rad == pytest.approx(rest_rad, abs=rad(0.01)), "it does not stand still"
    return ticks * TICK_S, abs(deg(rest_rad - at_rad))


@pytest.fixture
def moving() -> tuple[VirtualRig, Brain]:
    config = config_of()
    rig, brain = VirtualRig(config), Brain(config)
    turning(rig, brain)
    return rig, brain


@pytest.mark.parametrize("fault", ["silence", "garble", "freeze"])
@pytest.mark.parametrize("link", ["torque", "hall", "drive"])
def test_a_link_that_dies_in_mid_motion_stops_the_base(
    moving: tuple[VirtualRig, Brain], link: str, fault: str
) -> None:
    rig, brain = moving
    rig.fault[link] = fault
    taken_s, further_deg = until_fault(rig, brain, 0.3)
    assert taken_s <= 0.07 + (0.1 if (link, fault) == ("drive", "freeze") else 0.0)
    assert further_deg < 2.0
    if (link, fault) == ("drive", "freeze"):
        # its frames have no counter: it looks like a drive that does not turn
        assert brain.state.fault_name == FaultName.NOT_TURNING
    else:
        assert brain.state.fault_name == FaultName.LINK_DEAD
        assert link in (brain.state.fault or "")


def stuck_encoder(rig: VirtualRig) -> None:
    rig.plant.faults.encoder.stuck = True


def encoder_backwards(rig: VirtualRig) -> None:
    rig.plant.faults.encoder.gain = -1.0


def motor_backwards(rig: VirtualRig) -> None:
    rig.plant.faults.motor_gain = -1.0


def motor_dead(rig: VirtualRig) -> None:
    rig.plant.faults.motor_gain = 0.0


def motor_shorted(rig: VirtualRig) -> None:
    rig.plant.faults.motor_gain = 3.0


def foreign_command(rig: VirtualRig) -> None:
    rig.host.bring(0x205, bytes(6))


@pytest.mark.parametrize(
    ("harm", "names", "limit_s"),
    [
        (stuck_encoder, {FaultName.NOT_TURNING}, 0.2),
        (encoder_backwards, {FaultName.WRONG_DIRECTION, FaultName.NOT_TURNING}, 0.2),
        (motor_backwards, {FaultName.WRONG_DIRECTION, FaultName.NOT_TURNING}, 0.2),
        (motor_dead, {FaultName.NOT_TURNING}, 0.2),
        (motor_shorted, {FaultName.RUNAWAY}, 0.2),
        (foreign_command, {FaultName.SECOND_MASTER}, 0.02),
    ],
)
def test_a_machine_that_breaks_in_mid_motion_is_noticed(
    moving: tuple[VirtualRig, Brain],
    harm: Callable[[VirtualRig], None],
    names: set[FaultName],
    limit_s: float,
) -> None:
    rig, brain = moving
    harm(rig)
    until_fault(rig, brain, limit_s)
    assert brain.state.fault_name in names
    assert brain.state.latched


def test_an_emergency_of_the_drive_is_told_with_its_code(moving: tuple[VirtualRig, Brain]) -> None:
    rig, brain = moving
    rig.drive.fail(0x2310)
    taken_s, _ = until_fault(rig, brain, 0.1)
    assert taken_s <= 0.03
    assert "the drive stopped by itself: emergency 0x2310 (continuous over-current)" in (
        brain.state.fault or ""
    )
    assert brain.state.latched


def test_an_encoder_error_of_the_drive_has_its_own_bit(moving: tuple[VirtualRig, Brain]) -> None:
    rig, brain = moving
    rig.drive.fail(0x7305)
    until_fault(rig, brain, 0.1)
    assert rig.read().drive_faults == DriveFault.ENCODER
    assert "its encoder reports an error; check the cable; emergency 0x7305" in (brain.state.fault or "")


def test_a_drive_that_starts_again_has_lost_its_zero_and_sleeps(moving: tuple[VirtualRig, Brain]) -> None:
    rig, brain = moving
    rig.drive.reset(rig._steps * 1000)
    taken_s, _ = until_fault(rig, brain, 0.1)
    assert taken_s <= 0.03
    assert brain.state.fault_name in (FaultName.REFERENCE_LOST, FaultName.DRIVE_RESTARTED)
    assert not rig.read().referenced
    assert rig.rig._drive.needs_set_up(rig.host.now_s)


def test_a_lost_host_is_stopped_by_the_drive_itself(moving: tuple[VirtualRig, Brain]) -> None:
    rig, brain = moving
    rig.host_alive = False
    at_rad = rig.true_base_rad
    rig.advance(0.049)
    powered = [rig.drive.powered]
    rig.advance(0.06)
    powered.append(rig.drive.powered)
    assert powered == [True, False]
    assert rig.drive.state is DriveState.FAULT
    assert rig.drive.faults == DriveFault.HEARTBEAT
    rest_rad = rig.true_base_rad
    assert deg(rest_rad - at_rad) < 45.0 * 0.11
    rig.advance(1.0)
    assert rig.true_base_rad == pytest.approx(rest_rad, abs=rad(0.01))
    rig.host_alive = True
    until_fault(rig, brain, 0.1)
    assert not rig.drive.powered
    assert rig.read().drive_faults == DriveFault.HEARTBEAT


def test_after_a_clear_an_emergency_is_forgotten_and_the_base_turns_again(
    moving: tuple[VirtualRig, Brain],
) -> None:
    rig, brain = moving
    rig.drive.fail(0x4210)
    until_fault(rig, brain, 0.1)
    brain.clear()
    for _ in range(40):
        tick(rig, brain)
    assert brain.state.fault is None
    start_rad = rig.true_base_rad
    brain.jog(by_rad=rad(5.0))
    for _ in range(400):
        tick(rig, brain)
    assert deg(rig.true_base_rad - start_rad) == pytest.approx(5.0, abs=0.2)


def test_an_emergency_stop_takes_the_drives_power_and_latches(moving: tuple[VirtualRig, Brain]) -> None:
    rig, brain = moving
    rig.plant.faults.emergency_stop = True
    until_fault(rig, brain, 0.1)
    outcome = brain.state.outcome
    assert outcome is not None
    assert outcome.fault_name == FaultName.EMERGENCY_STOP
    assert rig.read().drive_state is DriveState.SILENT
    assert not rig.read().supply_on
    rig.plant.faults.emergency_stop = False
    for _ in range(200):
        tick(rig, brain)
    assert brain.state.latched
    with pytest.raises(RigFault, match="needle-rig clear"):
        brain.jog(by_rad=rad(1.0))
    brain.clear()
    for _ in range(20):
        tick(rig, brain)
    assert (brain.state.fault, rig.read().drive_state) == (None, DriveState.READY)


def test_a_saturated_sensor_is_no_torque(moving: tuple[VirtualRig, Brain]) -> None:
    rig, brain = moving
    rig.plant.faults.torque.dead_at = 1.0
    until_fault(rig, brain, 0.1)
    assert "the sensor's status is 0x80020000" in (brain.state.fault or "")


def test_a_sensor_without_its_magnet_is_named() -> None:
    config = config_of(hall=HALL.model_copy(update={"angle": "counts", "counts_per_turn": 4096}))
    rig, brain = VirtualRig(config), Brain(config)
    turning(rig, brain)
    whole = rig.text.step
    rig.text.step = lambda now_us, pairs: whole(now_us, (*pairs[:-1], (0, 0)))  # type: ignore[method-assign]
    until_fault(rig, brain, 0.2)
    assert "hall_4 says nan: its sensor does not answer" in (brain.state.fault or "")


@pytest.mark.parametrize("gain", [1.5, pytest.param(2.0, marks=pytest.mark.whole), 3.0])
def test_a_motor_that_turns_further_than_asked_is_stopped_within_six_degrees(gain: float) -> None:
    for start_deg in (3.0, 8.0, 35.0):
        config = config_of()
        rig, brain = VirtualRig(config), Brain(config)
        brain.compensate(Request(target_rad=rad(60.0), speed_rad_s=rad(60.0)))
        while rig.true_base_rad < rad(start_deg):
            tick(rig, brain)
        begun_rad, rig.plant.faults.motor_gain = rig.true_base_rad, gain
        taken_s, further_deg = until_fault(rig, brain, 0.3)
        assert brain.state.fault_name == FaultName.RUNAWAY
        # what was asked meanwhile is no more than 60°/s
        assert deg(rig.true_base_rad - begun_rad) - 60.0 * taken_s < 6.0, further_deg
