"""The following error: just inside and just outside each limit, at every speed, both ways."""

from __future__ import annotations

import dataclasses

import pytest

from needle_rig.control.faults import Fault, FaultName
from needle_rig.control.following import (
    DRIFT_RAD_S,
    REVERSE_SHARE,
    SCALE_TOLERANCE,
    CommandedPath,
    FollowingError,
    FollowingLimits,
)
from needle_rig.units import deg, rad

LIMITS = FollowingLimits(rad(1.5), 0.06)
TICK_S = 0.005
SPEEDS_DEG_S = (0.2, 1.0, 5.0, 9.0, 45.0, 60.0)


class Base:
    """A base that turns as a test says, at a constant command."""

    def __init__(self, commanded_deg_s: float, *, enabled: bool = True) -> None:
        self.error = FollowingError(LIMITS)
        self.commanded_deg_s, self.enabled = commanded_deg_s, enabled
        self.angle_deg = self.asked_deg = self.time_s = 0.0
        self.step(0.0)

    def step(self, commanded_deg_s: float) -> Fault | None:
        self.error.commanded(rad(commanded_deg_s), TICK_S)
        return self.error.sample(rad(self.angle_deg), 0.0, enabled=self.enabled)

    def turn(self, turned_deg_s: float, seconds: float) -> Fault | None:
        for _ in range(round(seconds / TICK_S)):
            self.time_s += TICK_S
            self.angle_deg += turned_deg_s * TICK_S
            self.asked_deg += self.commanded_deg_s * TICK_S
            fault = self.step(self.commanded_deg_s)
            if fault is not None:
                return fault
        return None


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("speed_deg_s", SPEEDS_DEG_S)
def test_a_base_that_stands_is_found_at_any_speed_by_what_was_asked(speed_deg_s: float, sign: int) -> None:
    base = Base(sign * speed_deg_s)
    fault = base.turn(0.0, 60.0)
    assert fault is not None
    assert (fault.name, fault.link, fault.latching) == (FaultName.NOT_TURNING, "drive", True)
    assert fault.text.endswith("then: needle-rig clear")
    late_deg = 0.06 * speed_deg_s
    share = 1.0 - SCALE_TOLERANCE - deg(DRIFT_RAD_S) / speed_deg_s
    assert abs(base.asked_deg) == pytest.approx(late_deg + 1.5 / share, abs=2.01 * speed_deg_s * TICK_S)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("speed_deg_s", SPEEDS_DEG_S)
def test_a_base_that_turns_the_other_way_is_found_in_half_of_that(speed_deg_s: float, sign: int) -> None:
    base = Base(sign * speed_deg_s)
    fault = base.turn(-sign * speed_deg_s, 60.0)
    assert fault is not None
    assert fault.name is FaultName.WRONG_DIRECTION
    share = 2.0 - SCALE_TOLERANCE - deg(DRIFT_RAD_S) / speed_deg_s
    assert abs(base.asked_deg) <= 0.03 * speed_deg_s + 1.5 / share + 2.1 * speed_deg_s * TICK_S


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("speed_deg_s", [5.0, 45.0, 60.0])
@pytest.mark.parametrize("factor", [1.2, 2.0, 5.0])
def test_a_base_that_turns_too_far_is_found(speed_deg_s: float, factor: float, sign: int) -> None:
    base = Base(sign * speed_deg_s)
    fault = base.turn(sign * factor * speed_deg_s, 60.0)
    assert fault is not None
    assert fault.name is FaultName.RUNAWAY
    beyond_deg = abs(base.angle_deg - base.asked_deg)
    assert beyond_deg <= (1.5 + 0.06 * speed_deg_s) / (1 - SCALE_TOLERANCE / (factor - 1)) + factor * 0.5


def test_a_base_that_moves_while_nothing_is_asked_is_found_within_two_degrees() -> None:
    for turned_deg_s in (-200.0, -3.0, 3.0, 200.0):
        base = Base(0.0, enabled=False)
        fault = base.turn(turned_deg_s, 5.0)
        assert fault is not None
        assert fault.name is FaultName.IDLE_MOTION
        assert "needle-rig release" in fault.text
        assert abs(base.angle_deg) <= 1.5 + 1.01 * abs(turned_deg_s) * TICK_S + 0.1


def test_a_base_that_comes_late_by_less_than_the_response_is_no_fault() -> None:
    for speed_deg_s in SPEEDS_DEG_S:
        base = Base(speed_deg_s)
        assert base.turn(0.0, 0.055) is None
        assert base.turn(speed_deg_s, 5.0) is None
        base.commanded_deg_s = 0.0
        base.enabled = False
        assert base.turn(speed_deg_s, 0.055) is None
        assert base.turn(0.0, 5.0) is None


def test_the_limit_itself_is_no_fault_and_a_hair_above_it_is() -> None:
    for beyond_deg, found in ((1.5 - 1e-6, False), (1.5 + 1e-6, True)):
        base = Base(0.0, enabled=False)
        base.angle_deg = beyond_deg + deg(DRIFT_RAD_S) * TICK_S
        assert (base.turn(0.0, TICK_S) is not None) == found


@pytest.mark.parametrize("asked_deg_s", [-45.0, 45.0])
def test_scales_that_differ_by_less_than_a_node_s_clock_are_no_fault(asked_deg_s: float) -> None:
    assert Base(asked_deg_s).turn(asked_deg_s * (1 + 0.9 * SCALE_TOLERANCE), 60.0) is None
    assert Base(asked_deg_s).turn(asked_deg_s * (1 - 0.9 * SCALE_TOLERANCE), 60.0) is None
    assert Base(asked_deg_s).turn(asked_deg_s * (1 - 1.5 * SCALE_TOLERANCE), 60.0) is not None


def test_a_slow_drift_is_forgiven_and_one_twice_as_fast_is_not() -> None:
    assert Base(0.0).turn(0.9 * deg(DRIFT_RAD_S), 600.0) is None
    assert Base(0.0).turn(2.0 * deg(DRIFT_RAD_S), 600.0) is not None


def test_a_reset_begins_anew_wherever_the_base_stands() -> None:
    base = Base(0.0, enabled=False)
    base.angle_deg = 1.4
    assert base.turn(0.0, TICK_S) is None
    base.error.rebase()
    base.angle_deg = 90.0
    assert base.turn(0.0, 1.0) is None
    base.angle_deg = 91.4
    assert base.turn(0.0, TICK_S) is None
    base.angle_deg = 91.7
    assert base.turn(0.0, TICK_S) is not None


def test_limits_stay_as_they_are() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        LIMITS.floor_rad = 1.0  # type: ignore[misc]


def test_the_commanded_path_is_asked_at_any_time_since_the_last_question() -> None:
    path = CommandedPath()
    assert path.now_s == 0.0
    path.add(0.0, 0.5)
    assert path.until(0.25) == (0.0, 0.0, 0.0)
    for velocity_rad_s in (4.0, 4.0, -2.0, 1.0):
        path.add(velocity_rad_s, 0.5)
    assert path.now_s == 2.5
    assert path.until(0.75) == (1.0, 4.0, 4.0)
    assert path.until(1.5) == (4.0, 4.0, 4.0), "what was in force until then, not from then on"
    assert path.until(1.75) == (3.5, -2.0, 4.0)
    assert path.until(2.5) == (3.5, 1.0, 2.0)
    assert path.until(2.5) == (3.5, 1.0, 1.0)


@pytest.mark.parametrize("age_ticks", [1, 4, 20, 50])
def test_a_sample_is_held_against_what_had_been_asked_when_it_was_taken(age_ticks: int) -> None:
    error, angles_deg = FollowingError(LIMITS), [0.0] * age_ticks
    for tick in range(600):
        asked_deg_s = (0.0, 60.0, -60.0, 0.0, 45.0, 0.0)[tick // 100]
        error.commanded(rad(asked_deg_s), TICK_S)
        angles_deg.append(angles_deg[-1] + asked_deg_s * TICK_S)
        seen_deg = angles_deg[-1 - age_ticks]
        assert error.sample(rad(seen_deg), age_ticks * TICK_S, enabled=True) is None
        assert error.error_rad == pytest.approx(0.0, abs=rad(0.01))


def test_a_base_that_stands_is_found_also_where_it_is_heard_rarely_and_late() -> None:
    error = FollowingError(LIMITS)
    asked_deg = 0.0
    for tick in range(200):
        error.commanded(rad(45.0), TICK_S)
        asked_deg += 45.0 * TICK_S
        fault = error.sample(0.0, 0.05 + tick % 10 * TICK_S, enabled=True)  # one sample in ten ticks
        if fault is not None:
            break
    assert fault is not None
    assert fault.name is FaultName.NOT_TURNING
    assert asked_deg <= 1.05 * (0.06 * 45.0 + 1.5) + 45.0 * (0.1 + 10 * TICK_S)


def test_what_was_asked_before_widens_the_limit_no_longer_than_the_answer_takes() -> None:
    base = Base(60.0)
    assert base.turn(60.0, 1.0) is None
    base.commanded_deg_s = 0.0
    assert base.turn(0.0, 1.0) is None
    base.angle_deg += 1.6
    assert base.turn(0.0, TICK_S) is not None


def test_an_enabled_base_that_turns_though_nothing_was_asked_runs_away() -> None:
    for turned_deg_s in (-50.0, 50.0):
        fault = Base(0.0).turn(turned_deg_s, 1.0)
        assert fault is not None
        assert fault.name is FaultName.RUNAWAY


@pytest.mark.parametrize("speed_deg_s", [-45.0, -5.0, 5.0, 45.0])
@pytest.mark.parametrize(
    ("share", "name"),
    [(0.8, FaultName.NOT_TURNING), (0.5, FaultName.NOT_TURNING), (1.25, FaultName.WRONG_DIRECTION)],
)
def test_an_encoder_that_creeps_back_stands_still(speed_deg_s: float, share: float, name: FaultName) -> None:
    fault = Base(speed_deg_s).turn(-share * REVERSE_SHARE * speed_deg_s, 60.0)
    assert fault is not None
    assert fault.name is name


def nearly_found(speed_deg_s: float) -> Base:
    """A base that was asked to turn and stands, one tick before that is a fault."""
    base = Base(speed_deg_s)
    ticks = next(tick for tick in range(1000) if base.turn(0.0, TICK_S) is not None)
    base = Base(speed_deg_s)
    assert base.turn(0.0, ticks * TICK_S) is None
    return base


def test_one_flicker_of_an_encoder_that_stands_is_no_turning_back() -> None:
    fault = nearly_found(45.0).turn(-2.0 * REVERSE_SHARE * 45.0, TICK_S)
    assert fault is not None
    assert fault.name is FaultName.NOT_TURNING


def test_a_command_that_turns_round_at_last_does_not_make_a_base_that_stands_run_away() -> None:
    base = nearly_found(45.0)
    base.commanded_deg_s = -1.0
    fault = base.turn(0.0, 10 * TICK_S)
    assert fault is not None
    assert fault.name is FaultName.NOT_TURNING


def test_a_base_that_turned_back_long_ago_and_stands_now_stands() -> None:
    base = Base(-45.0)
    assert base.turn(-45.0, 2.0) is None
    base.commanded_deg_s = 0.0
    assert base.turn(0.0, 1.0) is None
    base.commanded_deg_s = 45.0
    fault = base.turn(0.0, 1.0)
    assert fault is not None
    assert fault.name is FaultName.NOT_TURNING
