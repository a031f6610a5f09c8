from __future__ import annotations

import asyncio
import dataclasses
import math
import time
from typing import Any

import numpy as np
import pytest

from needle_rig.config.schema import RigConfig, SimulationSection
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.model import load_parameters
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.records import Command, DriveFault, DriveState, Sample
from needle_rig.simulation.drive.drive_guard import DriveGuard
from needle_rig.simulation.drive.motor import Motor, MotorSettings
from needle_rig.simulation.plant import Plant
from needle_rig.simulation.run import run_virtual
from needle_rig.units import deg, nm, nmm, rad
from tests.closed_loop.conftest import simulation_of
from tests.values import now


@pytest.fixture(scope="module")
def elastic() -> NeedleModel:
    return load_parameters("rig_elastic")


def awake(model: NeedleModel, settings: SimulationSection, **options: Any) -> Plant:
    plant = Plant(model, settings, **options)
    for command in (Command(), Command(clear=True), *[Command()] * 5):
        plant.write(command)
        plant.advance(0.005)
    assert plant.read().drive_state is DriveState.READY
    return plant


def turned(plant: Plant, velocity_rad_s: float, seconds: float, tick_s: float = 0.005) -> Plant:
    for _ in range(round(seconds / tick_s)):
        plant.write(Command(velocity_rad_s, enable=True))
        plant.advance(tick_s)
    return plant


def test_the_same_seed_gives_the_same_run_to_the_last_bit_and_another_one_does_not(
    config: RigConfig, elastic: NeedleModel
) -> None:
    def rows(seed: int) -> tuple[Sample, ...]:
        settings = simulation_of(config).model_copy(update={"seed": seed})
        run = run_virtual(Brain(config), Plant(elastic, settings), Request(0.5, "none", settle_s=0.5))
        return run.samples

    assert rows(3) == rows(3)
    assert rows(3) != rows(4)


@pytest.mark.whole
def test_the_tick_does_not_change_what_the_needle_does(config: RigConfig, elastic: NeedleModel) -> None:
    quiet = simulation_of(config).model_copy(update={"torque_noise_nmm": 0.0, "hall_noise_deg": 0.0})
    ends = []
    for tick_s in (0.002, 0.005, 0.010):
        run = run_virtual(
            Brain(config), Plant(elastic, quiet), Request(rad(45.0), settle_s=0.2), tick_s=tick_s
        )
        ends.append(deg(run.outcome.tip_lag_rad))
    assert ends == pytest.approx([ends[0]] * 3, abs=0.1)


def test_a_small_continued_step_gives_the_same_as_one_solution_of_the_whole_path(
    config: RigConfig, elastic: NeedleModel
) -> None:
    from needle_rig.physics.effect import Trial

    plant = awake(elastic, simulation_of(config))
    times, angles = [0.0], [plant.motor.angle_rad]
    for velocity in (0.8, -0.8, 0.4):
        for _ in range(100):
            plant.turn(velocity, 0.005)
            times.append(times[-1] + 0.005)
            angles.append(plant.motor.angle_rad)
    whole = elastic.truth(Trial(np.array(times), np.array(angles)))
    assert deg(plant.hall_rad) == pytest.approx(deg(whole.sensor_rad[-1]), abs=0.02)
    assert nmm(plant.torque_nm) == pytest.approx(nmm(whole.torque_nm[-1]), abs=1e-4)
    assert plant.shaft_rad()[-1] == pytest.approx(whole.tip_rad[-1], abs=rad(0.02))


def test_a_base_that_creeps_winds_the_needle_up_as_a_quick_one_does(
    config: RigConfig, elastic: NeedleModel
) -> None:
    quick, creeping = (Plant(elastic, simulation_of(config)) for _ in range(2))
    for plant, velocity_deg_s, ticks in ((quick, 20.0, 10), (creeping, 0.04, 5000)):
        for _ in range(ticks):
            plant.turn_by_hand(rad(velocity_deg_s), 0.005)
        for _ in range(200):
            plant.turn_by_hand(0.0, 0.005)
    assert nmm(quick.torque_nm) > 0.002
    assert deg(creeping.true_base_rad) == pytest.approx(1.0, abs=0.05)
    assert nmm(creeping.torque_nm) == pytest.approx(nmm(quick.torque_nm), rel=0.1)


def test_sensors_are_quantised_and_as_noisy_as_stated(config: RigConfig, elastic: NeedleModel) -> None:
    settings = simulation_of(config)
    plant = Plant(elastic, settings)
    torque, hall = [], []
    for _ in range(2000):
        plant.advance(0.001)
        measurement = plant.read()
        torque.append(nmm(measurement.torque_nm))
        hall.append(deg(measurement.hall_rad[2]))
        assert deg(measurement.base_angle_rad) % 0.01 == pytest.approx(0.0, abs=1e-9)
    steps = np.array(hall) / settings.hall_step_deg
    assert np.allclose(steps, np.rint(steps))
    steps = np.array(torque) / settings.torque_step_nmm
    assert np.allclose(steps, np.rint(steps))
    assert np.std(torque) == pytest.approx(settings.torque_noise_nmm, rel=0.1)
    assert np.std(hall) == pytest.approx(settings.hall_noise_deg, rel=0.1)
    assert abs(np.mean(hall)) < 0.02


def test_effects_on_the_sensors_act_on_the_readings_and_not_on_the_needle(
    config: RigConfig, elastic: NeedleModel
) -> None:
    from needle_rig.physics.effects.torque_bias import TorqueBias

    quiet = simulation_of(config).model_copy(update={"torque_noise_nmm": 0.0, "hall_noise_deg": 0.0})
    (field,) = TorqueBias.parameters()
    biased = elastic.with_effects(TorqueBias(**{field: 0.02}))
    plain, shifted = awake(elastic, quiet), awake(biased, quiet)
    turned(plain, 0.5, 1.0)
    turned(shifted, 0.5, 1.0)
    assert shifted.torque_nm == plain.torque_nm
    difference = nmm(shifted.read().torque_nm - plain.read().torque_nm)
    assert difference == pytest.approx(0.02, abs=2e-4)


def test_effects_on_the_sensors_remember_for_longer_than_readings_are_kept(
    config: RigConfig, elastic: NeedleModel
) -> None:
    from needle_rig.physics.effects.bearing_drag import BearingDrag
    from needle_rig.physics.effects.torque_low_pass import TorqueLowPass

    noiseless = {"torque_noise_nmm": 0.0, "hall_noise_deg": 0.0}
    quiet = simulation_of(config).model_copy(update=noiseless)
    plain, draggy = awake(elastic, quiet), awake(elastic.with_effects(BearingDrag(0.02)), quiet)
    slow = awake(elastic.with_effects(TorqueLowPass(1000.0)), quiet)
    for plant in (plain, draggy, slow):
        turned(turned(plant, 0.5, 1.0), 0.0, 0.5)  # 100 ticks of rest, 64 readings are kept
    assert nmm(draggy.read().torque_nm - plain.read().torque_nm) == pytest.approx(0.02, abs=2e-4)
    left = [nmm(plain.torque_nm - slow.read().torque_nm)]
    turned(slow, 0.0, 1.0)
    left.append(nmm(plain.torque_nm - slow.read().torque_nm))
    assert left[1] / left[0] == pytest.approx(math.exp(-1.0), abs=0.02)


def test_effects_at_the_base_remember_from_tick_to_tick(config: RigConfig, elastic: NeedleModel) -> None:
    from needle_rig.physics.effects.chuck_backlash import ChuckBacklash

    (field,) = ChuckBacklash.parameters()
    loose = elastic.with_effects(ChuckBacklash(**{field: 6.0}))
    plant = awake(loose, simulation_of(config))
    turned(turned(plant, 0.5, 2.0), 0.0, 0.5)
    wound = plant.hall_rad.copy()
    before = deg(plant.motor.angle_rad)
    while deg(plant.motor.angle_rad) > before - 4.0:
        turned(plant, -0.5, 0.05)
    # the play is not used up: the needle has not noticed
    assert plant.hall_rad == pytest.approx(wound, abs=1e-6)
    turned(plant, -0.5, 1.0)
    assert plant.hall_rad[0] < wound[0] - rad(1.0)


def test_raw_readings_come_with_counters_and_times(config: RigConfig, elastic: NeedleModel) -> None:
    rows = []
    plant = Plant(elastic, simulation_of(config), raw=lambda source, row: rows.append((source, row)))
    for _ in range(3):
        plant.advance(0.005)
    torque = [row for source, row in rows if source == "torque"]
    assert [row[2] for row in torque] == [0.0, 1.0, 2.0, 3.0]
    assert [row[0] for row in torque] == pytest.approx([0.0, 0.005, 0.010, 0.015])
    assert [len(row) for source, row in rows if source == "hall"] == [7] * 4
    assert [len(row) for source, row in rows if source == "drive"] == [6] * 4


def test_it_opens_and_closes_as_a_rig(config: RigConfig, elastic: NeedleModel) -> None:
    async def use() -> None:
        plant = Plant(elastic, simulation_of(config))
        await plant.open()
        turned(plant, 0.5, 0.1)
        await plant.close()
        await plant.close()

    asyncio.run(use())


class Guarded:
    """A guard that is stepped every millisecond, its torque node alive, its shaft as asked."""

    def __init__(self) -> None:
        self.guard, self.now_us, self.said = DriveGuard(), 0, 0
        self.asked, self.angle_mdeg = 0, 0.0
        self.step(Command())
        self.step(Command())

    def step(self, command: Command | None = None, torque_nm: float = 0.0) -> float:
        if command is not None:
            self.said += 1
            self.guard.receive(self.now_us, command, self.said % 16, self.said)
        self.guard.torque(self.now_us, torque_nm)
        self.angle_mdeg += self.guard.motion.expected_q8 / 256 * 1e-4
        velocity = self.guard.step(self.now_us, rad(self.angle_mdeg * 1e-3), self.asked)
        self.asked = round(deg(velocity) * 1e4)
        self.now_us += 1000
        return velocity

    def rest(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.step(Command())

    @property
    def state(self) -> tuple[DriveState, DriveFault]:
        return self.guard.state, self.guard.faults


def running() -> Guarded:
    guarded = Guarded()
    guarded.step(Command(clear=True))
    guarded.rest(20)
    guarded.step(Command(0.5, enable=True))
    return guarded


class TestDriveGuard:
    def test_silent_until_cleared_and_still_until_the_supply_is_on(self) -> None:
        guarded = Guarded()
        assert guarded.step(Command(0.5, enable=True)) == 0.0
        assert now(guarded.state) == (DriveState.SILENT, DriveFault.NONE)
        assert not now(guarded.guard.supply)
        guarded.step(Command(clear=True))
        assert now(guarded.state) == (DriveState.READY, DriveFault.NONE)
        assert guarded.guard.supply
        assert guarded.step(Command(0.5, enable=True)) == 0.0
        guarded.rest(20)
        assert guarded.step(Command(0.5, enable=True)) == 0.5
        assert guarded.state == (DriveState.RUNNING, DriveFault.NONE)

    def test_without_commands_it_stops_after_50_ms(self) -> None:
        guarded = running()
        # the command came in the step before the first of these
        assert next(ms for ms in range(1, 1000) if guarded.step() == 0.0) == 51
        assert guarded.state == (DriveState.FAULT, DriveFault.COMMAND_AGE)
        guarded.step(Command())
        guarded.step(Command())
        guarded.step(Command(clear=True))
        assert guarded.state == (DriveState.READY, DriveFault.NONE)

    @pytest.mark.parametrize(
        ("torque", "velocity", "bit"),
        [(nm(2.1), 0.5, DriveFault.TORQUE_TRIP), (0.0, rad(91.0), DriveFault.VELOCITY)],
    )
    def test_latching_faults_want_rest_and_a_person_before_a_clear(
        self, torque: float, velocity: float, bit: DriveFault
    ) -> None:
        guarded = running()
        assert guarded.step(Command(velocity, enable=True), torque) == 0.0
        assert guarded.state == (DriveState.FAULT, bit)
        guarded.step(Command())
        guarded.step(Command(clear=True, acknowledge=True))
        assert guarded.state == (DriveState.FAULT, bit)
        guarded.rest(110)
        guarded.step(Command(clear=True))
        assert guarded.state == (DriveState.FAULT, bit)
        guarded.step(Command())
        guarded.step(Command(clear=True, acknowledge=True))
        assert guarded.state == (DriveState.READY, DriveFault.NONE)

    def test_a_stuck_clear_clears_once(self) -> None:
        guarded = running()
        guarded.step(torque_nm=nm(3.0))
        guarded.rest(110)
        for _ in range(200):
            guarded.step(Command(clear=True, acknowledge=True))
        assert guarded.state == (DriveState.READY, DriveFault.NONE)
        guarded.step(Command(0.5, enable=True, clear=True), torque_nm=nm(3.0))
        for _ in range(200):
            guarded.step(Command(clear=True, acknowledge=True))
        assert guarded.state == (DriveState.FAULT, DriveFault.TORQUE_TRIP)

    def test_at_its_angle_limit_it_holds_and_may_turn_back(self) -> None:
        guarded = Guarded()
        guarded.rest(110)
        assert guarded.guard.reference(guarded.now_us, guarded.said, rad(720.5))
        guarded.angle_mdeg = 720_500.0
        guarded.step(Command(clear=True))
        guarded.rest(20)
        assert guarded.step(Command(0.5, enable=True)) == 0.0
        assert guarded.guard.state is DriveState.RUNNING
        assert guarded.step(Command(-0.5, enable=True)) == -0.5


class TestMotor:
    def test_gain_delay_and_lag(self) -> None:
        motor = Motor(MotorSettings(gain=1.2, delay_s=0.010, time_constant_s=0.020))
        motor.turn(1.0)
        motor.advance(0.010, 0.0)
        assert motor.angle_rad == 0.0
        motor.advance(0.020, 0.0)
        assert motor.velocity_rad_s == pytest.approx(1.2 * (1.0 - math.exp(-1.0)))
        assert motor.angle_rad == pytest.approx(1.2 * (0.020 - 0.020 * (1.0 - math.exp(-1.0))))

    def test_the_path_has_its_kinks(self) -> None:
        motor = Motor(MotorSettings(delay_s=0.002))
        motor.turn(1.0)
        path = motor.advance(0.005, 0.0)
        assert [time_s for time_s, _ in path] == pytest.approx([0.002, 0.005])
        assert [angle for _, angle in path] == pytest.approx([0.0, 0.003])

    def test_long_and_short_steps_agree(self) -> None:
        ends = []
        for steps in (1, 7):
            motor = Motor(MotorSettings(1.1, 0.003, 0.015, 5.0, nm(0.1)))
            motor.turn(0.7)
            for _ in range(steps):
                motor.advance(0.05 / steps, nm(0.2))
            ends.append((motor.angle_rad, motor.velocity_rad_s))
        assert ends[0] == pytest.approx(ends[1])

    def test_droop_pushes_back_only_while_powered(self) -> None:
        motor = Motor(MotorSettings(droop_rad_s_per_nm=100.0))
        motor.turn(0.0)
        motor.advance(1.0, 1e-3)
        assert motor.angle_rad == pytest.approx(-0.1)
        motor.turn(0.0, powered=False)
        motor.advance(1.0, 1e-3)
        assert motor.angle_rad == pytest.approx(-0.1)


def test_a_whole_run_is_many_times_faster_than_the_rig(config: RigConfig, elastic: NeedleModel) -> None:
    brain, plant = Brain(config), Plant(elastic, simulation_of(config))
    start = time.process_time()
    run = run_virtual(brain, plant, Request(rad(45.0)))
    spent = time.process_time() - start
    assert run.time_s > 20.0
    assert spent < run.time_s / 4.0


def test_a_cut_off_brain_leaves_the_drive_to_stop_itself(config: RigConfig, elastic: NeedleModel) -> None:
    plant = turned(awake(elastic, simulation_of(config)), 0.5, 0.5)
    assert plant.read().drive_state is DriveState.RUNNING
    for _ in range(80):
        plant.advance(0.001)
    at_stop = plant.motor.angle_rad
    for _ in range(500):
        plant.advance(0.001)
    measurement = plant.read()
    assert (measurement.drive_state, measurement.drive_faults) == (DriveState.FAULT, DriveFault.COMMAND_AGE)
    assert deg(plant.motor.angle_rad - at_stop) < 0.5
    assert dataclasses.replace(measurement, time_s=0.0) != measurement
