"""Encoder, torque cell and Hall sensors against one another: just inside and just outside the limits."""

from __future__ import annotations

import dataclasses

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.faults import Fault, FaultName
from needle_rig.control.in_si import layout_of, torsional_rigidity_nm2
from needle_rig.control.reports import Request
from needle_rig.control.shaft import ShaftWatch, base_by_hall_rad, shaft_limits, spring_to_first_sensor
from needle_rig.model import load_parameters
from needle_rig.physics.library import built_in_effects
from needle_rig.records import Measurement
from needle_rig.simulation.plant import Plant
from needle_rig.simulation.run import run_virtual
from needle_rig.units import deg, nm, rad

CONFIG = load_rig_config(None)
LAYOUT, RIGIDITY_NM2 = layout_of(CONFIG), torsional_rigidity_nm2(CONFIG)
SPRING = spring_to_first_sensor(LAYOUT, RIGIDITY_NM2)
TICK_S = 0.005
FRICTION_NM = nm(0.1)


class Shaft:
    """A shaft that winds up to its friction and then turns as one; every witness may lie."""

    def __init__(
        self, disagreement_deg: float = 8.0, windup_deg: float = 270.0, travel_deg: float = 7200.0
    ) -> None:
        self.watch = ShaftWatch(shaft_limits(disagreement_deg, windup_deg, travel_deg), LAYOUT, RIGIDITY_NM2)
        self.watch.begin()
        self.base_rad = self.hall_rad = self.torque_nm = 0.0
        self.lies: dict[str, object] = {}

    def read(self) -> Measurement:
        twist_rad = self.base_rad - self.hall_rad
        most_rad = FRICTION_NM * SPRING.middle
        if abs(twist_rad) > most_rad:
            self.hall_rad = self.base_rad - (most_rad if twist_rad > 0 else -most_rad)
        self.torque_nm = (self.base_rad - self.hall_rad) / SPRING.middle
        truth = Measurement(
            0.0,
            self.base_rad,
            self.torque_nm,
            (self.hall_rad,) * 4,
            torque_age_s=0.001,
            hall_age_s=0.001,
            drive_age_s=0.001,
        )
        return dataclasses.replace(truth, **{n: f(truth) for n, f in self.lies.items()})  # type: ignore[operator]

    def turn(self, by_deg: float, speed_deg_s: float = 45.0) -> Fault | None:
        steps = max(1, round(abs(by_deg) / speed_deg_s / TICK_S))
        for _ in range(steps):
            self.base_rad += rad(by_deg) / steps
            fault = self.watch.step(self.read(), TICK_S)
            if fault is not None:
                return fault
        return None


def test_the_spring_lies_between_all_and_nothing_of_the_friction_on_the_way() -> None:
    assert (SPRING.least, SPRING.most) == pytest.approx((0.175 / 62.56e-6, 0.220 / 62.56e-6))
    assert base_by_hall_rad(Measurement(0.0, 9.0, nm(0.1), (0.5,) * 4), SPRING) == pytest.approx(
        0.5 + nm(0.1) * 0.1975 / 62.56e-6
    )


def test_a_shaft_that_winds_up_turns_and_unwinds_is_in_order() -> None:
    shaft = Shaft()
    for by_deg in (45.0, -90.0, 300.0, -1.0, -254.0):
        assert shaft.turn(by_deg) is None
        shaft.watch.motion()


def test_a_dead_torque_cell_is_named_within_a_few_degrees_of_twist() -> None:
    shaft = Shaft()
    shaft.lies = {"torque_nm": lambda m: 0.0}
    fault = shaft.turn(45.0)
    assert fault is not None
    assert (fault.name, fault.latching) == (FaultName.TWIST_WITHOUT_TORQUE, True)
    assert 8.0 < deg(shaft.base_rad) < 11.0
    assert "drive.disagreement_deg" in fault.text


def test_a_coupling_that_slips_looks_like_it_and_says_so() -> None:
    shaft = Shaft()
    shaft.lies = {"torque_nm": lambda m: 0.0, "hall_rad": lambda m: (0.0,) * 4}
    fault = shaft.turn(45.0)
    assert fault is not None
    assert fault.name is FaultName.TWIST_WITHOUT_TORQUE
    assert "coupling" in fault.text


def test_a_torque_without_a_twist_is_named() -> None:
    shaft = Shaft()
    assert shaft.turn(1.0) is None
    shaft.lies = {"torque_nm": lambda m: m.torque_nm + nm(0.2)}
    fault = shaft.turn(0.5, speed_deg_s=1.0)
    assert fault is not None
    assert fault.name is FaultName.TORQUE_WITHOUT_TWIST


def test_an_encoder_that_stands_while_the_needle_turns_is_named() -> None:
    shaft = Shaft()
    assert shaft.turn(60.0) is None
    shaft.watch.motion()
    held = shaft.base_rad
    shaft.lies = {"base_angle_rad": lambda m: held}
    fault = shaft.turn(45.0)
    assert fault is not None
    assert fault.name is FaultName.ENCODER_DISAGREES
    assert "the needle turns and the encoder does not" in fault.text
    assert deg(shaft.base_rad) - 60.0 < 15.0


@pytest.mark.parametrize("scale", [0.5, 0.75, 1.5, 2.0])
def test_an_encoder_with_a_wrong_scale_is_found_in_a_turn(scale: float) -> None:
    shaft = Shaft()
    shaft.lies = {"base_angle_rad": lambda m: m.base_angle_rad * scale}
    fault = shaft.turn(90.0)
    assert fault is not None
    assert fault.name is FaultName.ENCODER_DISAGREES


@pytest.mark.parametrize("sensor", range(4))
def test_a_hall_angle_that_jumps_is_named_with_its_sensor(sensor: int) -> None:
    for jump_deg, found in ((29.9, False), (30.1, True), (-90.0, True), (360.0, True)):
        other = Shaft(disagreement_deg=90.0, windup_deg=3600.0)
        assert other.turn(30.0) is None
        before = other.read().hall_rad

        def jumped(m: Measurement, jump_deg: float = jump_deg) -> tuple[float, ...]:
            return tuple(a + (rad(jump_deg) if i == sensor else 0.0) for i, a in enumerate(m.hall_rad))

        other.lies = {"hall_rad": jumped}
        fault = other.watch.step(other.read(), TICK_S)
        assert (fault is not None) == found, (jump_deg, before)
        if fault is not None:
            assert fault.name is FaultName.HALL_JUMP
            assert f"Hall sensor {sensor + 1} " in fault.text


@pytest.mark.parametrize("sensor", [1, 2, 3])
def test_a_hall_sensor_that_stands_while_its_neighbours_move_is_named(sensor: int) -> None:
    shaft = Shaft()
    assert shaft.turn(45.0) is None
    held = shaft.read().hall_rad[sensor]
    shaft.lies = {"hall_rad": lambda m: tuple(held if i == sensor else a for i, a in enumerate(m.hall_rad))}
    fault = shaft.turn(90.0)
    assert fault is not None
    assert fault.name is FaultName.HALL_DISAGREES
    assert deg(shaft.base_rad) - 45.0 < 45.0


def test_windup_and_travel_have_their_limits() -> None:
    shaft = Shaft(windup_deg=15.0)
    fault = shaft.turn(45.0)
    assert fault is not None
    assert fault.name is FaultName.WINDUP_LIMIT
    assert fault.latching
    assert deg(shaft.base_rad) == pytest.approx(15.1, abs=0.25)
    shaft = Shaft(travel_deg=100.0)
    assert shaft.turn(45.0) is None
    assert shaft.turn(-45.0) is None
    fault = shaft.turn(45.0)
    assert fault is not None
    assert fault.name is FaultName.TRAVEL_LIMIT
    assert deg(shaft.base_rad) == pytest.approx(11.0, abs=2.0)


def test_a_needle_wound_by_more_than_half_a_turn_stays_so_through_a_reference() -> None:
    shaft = Shaft(disagreement_deg=400.0, windup_deg=300.0)
    shaft.lies = {"hall_rad": lambda m: (*m.hall_rad[:-1], 0.0)}  # the tip is caught
    assert shaft.turn(250.0) is None
    shaft.watch.rebase()
    fault = shaft.turn(60.0)
    assert fault is not None
    assert fault.name is FaultName.WINDUP_LIMIT
    assert deg(shaft.base_rad) == pytest.approx(300.0, abs=0.5)


def test_turns_that_the_hall_angles_count_from_elsewhere_are_no_windup() -> None:
    shaft = Shaft(windup_deg=30.0)
    shaft.lies = {"hall_rad": lambda m: (*m.hall_rad[:-1], m.hall_rad[-1] + rad(720.0))}
    assert shaft.turn(20.0) is None
    shaft.watch.rebase()
    assert shaft.turn(20.0) is None


def test_an_encoder_that_flickers_travels_nowhere() -> None:
    shaft = Shaft(travel_deg=10.0)
    for _ in range(1000):
        assert shaft.turn(0.9, 1000.0) is None
        assert shaft.turn(-0.9, 1000.0) is None


def test_what_was_wrong_before_a_motion_counts_until_a_reference() -> None:
    shaft = Shaft()
    shaft.lies = {"torque_nm": lambda m: 0.0}
    assert shaft.turn(6.0) is None
    shaft.watch.motion()
    assert shaft.turn(2.0) is None
    shaft.watch.begin()
    fault = shaft.turn(2.0)
    assert fault is not None
    assert "since the last reference" in fault.text
    assert shaft.turn(0.1) is not None, "a clear of a person does not settle it"
    shaft.watch.rebase()
    assert shaft.turn(6.0) is None


@pytest.mark.parametrize("name", sorted(built_in_effects()))
def test_an_effect_of_the_library_at_its_typical_size_is_no_fault(name: str) -> None:
    # the limits are degrees: a coarse shaft, looked at every 0.9° of a turn, is within a tenth of them
    coarse = dataclasses.replace(load_parameters("rig_elastic"), element_length_m=0.01)
    model = coarse.with_effects(built_in_effects()[name].at_strength(1.0))
    settings = CONFIG.simulation
    assert settings is not None
    request = Request(rad(45.0), "reed2008", settle_s=0.3)
    run = run_virtual(Brain(CONFIG), Plant(model, settings), request, tick_s=0.02)
    assert run.outcome.status in ("aligned", "not_aligned"), run.outcome.text


@pytest.mark.parametrize("every", [1, 40])
def test_old_answers_that_come_every_few_ticks_do_not_blind_the_watch(every: int) -> None:
    shaft, tick_s, old = Shaft(), 0.001, 40
    encoder_rad = [0.0] * (old + every)
    for tick in range(old + every, 5000):
        shaft.base_rad += rad(60.0) * tick_s
        truth = shaft.read()
        encoder_rad.append(0.5 * truth.base_angle_rad)
        age = old + tick % every
        seen = dataclasses.replace(
            truth, time_s=tick * tick_s, base_angle_rad=encoder_rad[tick - age], drive_age_s=age * tick_s
        )
        fault = shaft.watch.step(seen, tick_s)
        if fault is not None:
            break
    assert fault is not None
    assert fault.name is FaultName.ENCODER_DISAGREES
    assert deg(shaft.base_rad) < 60.0


OFFSETS_RAD = (0.4, -0.3, 0.9, -1.1)


def test_zeros_of_hall_sensors_are_nothing_that_is_wrong() -> None:
    shaft = Shaft()
    shaft.lies = {
        "hall_rad": lambda m: tuple(a + o for a, o in zip(m.hall_rad, OFFSETS_RAD, strict=True)),
    }
    for to_deg in (360.0, -400.0, 300.0):
        assert shaft.turn(to_deg) is None


@pytest.mark.parametrize("offsets_rad", [(0.0,) * 4, OFFSETS_RAD])
def test_what_is_told_of_a_wrong_scale_is_what_each_witness_saw(offsets_rad: tuple[float, ...]) -> None:
    shaft = Shaft()
    shaft.lies = {
        "hall_rad": lambda m: tuple(a + o for a, o in zip(m.hall_rad, offsets_rad, strict=True)),
        "base_angle_rad": lambda m: 0.5 * m.base_angle_rad,
    }
    assert shaft.turn(0.0) is None
    fault = shaft.turn(90.0)
    assert fault is not None
    assert fault.name is FaultName.ENCODER_DISAGREES
    assert fault.latching
    seen = f"encoder turned by {deg(0.5 * shaft.base_rad):.1f}°, Hall sensor 1 by {deg(shaft.hall_rad):.1f}°,"
    assert seen in fault.text


def test_a_hall_sensor_that_jumps_is_named_by_its_number_and_its_size() -> None:
    shaft = Shaft()
    assert shaft.turn(5.0) is None
    shaft.lies = {"hall_rad": lambda m: (*m.hall_rad[:2], m.hall_rad[2] + rad(40.0), m.hall_rad[3])}
    fault = shaft.watch.step(shaft.read(), TICK_S)
    assert fault is not None
    assert (fault.name, fault.latching) == (FaultName.HALL_JUMP, True)
    assert "Hall sensor 3 jumped by 40° from one reading to the next, limit 30°" in fault.text
