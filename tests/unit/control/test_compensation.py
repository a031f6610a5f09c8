from __future__ import annotations

import itertools
import math
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import pytest

from needle_rig.control.compensation import (
    ACTIVE,
    TRANSITIONS,
    Event,
    Sequence,
    Think,
    after,
    think_at_once,
)
from needle_rig.control.reports import settled_motion
from needle_rig.control.strategy import Dither, History, Reason, Strategy, Task, Waypoint
from needle_rig.errors import BadInput, RigFault
from needle_rig.model import EXPERIMENT_LAYOUT
from needle_rig.records import Measurement, Phase
from needle_rig.units import rad
from tests.values import known, now

LEGAL = {
    ("idle", "start"): "rest",
    ("idle", "abort"): "aborted",
    ("idle", "fault"): "fault",
    ("idle", "clear"): "idle",
    ("idle", "hold"): "holding",
    ("idle", "release"): "idle",
    ("rest", "next"): "moving",
    ("rest", "finished"): "done",
    ("rest", "abort"): "aborted",
    ("rest", "fault"): "fault",
    ("moving", "arrived"): "settling",
    ("moving", "finished"): "done",
    ("moving", "abort"): "aborted",
    ("moving", "fault"): "fault",
    ("settling", "settled"): "measuring",
    ("settling", "finished"): "done",
    ("settling", "abort"): "aborted",
    ("settling", "fault"): "fault",
    ("measuring", "disturbed"): "settling",
    ("measuring", "next"): "moving",
    ("measuring", "finished"): "done",
    ("measuring", "abort"): "aborted",
    ("measuring", "fault"): "fault",
    ("done", "start"): "rest",
    ("done", "abort"): "aborted",
    ("done", "fault"): "fault",
    ("holding", "release"): "idle",
    ("holding", "abort"): "aborted",
    ("holding", "fault"): "fault",
    ("done", "clear"): "idle",
    ("done", "hold"): "holding",
    ("done", "release"): "idle",
    ("aborted", "start"): "rest",
    ("aborted", "abort"): "aborted",
    ("aborted", "fault"): "fault",
    ("aborted", "clear"): "idle",
    ("aborted", "hold"): "holding",
    ("aborted", "release"): "idle",
    ("fault", "release"): "fault",
    ("fault", "abort"): "fault",
    ("fault", "fault"): "fault",
    ("fault", "clear"): "idle",
}


@pytest.mark.parametrize(("phase", "event"), list(itertools.product(Phase, Event)))
def test_every_phase_and_event(phase: Phase, event: Event) -> None:
    expected = LEGAL.get((phase.value, event.value))
    if expected is None:
        with pytest.raises(ValueError, match=f"event {event} does not belong to phase {phase}"):
            after(phase, event)
    else:
        assert after(phase, event) is Phase(expected)


@pytest.mark.parametrize("phase", Phase)
def test_a_fault_is_reached_from_every_phase_at_once_and_an_abort_from_all_but_a_fault(phase: Phase) -> None:
    assert after(phase, Event.FAULT) is Phase.FAULT
    assert after(phase, Event.ABORT) is (Phase.FAULT if phase is Phase.FAULT else Phase.ABORTED)


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_can_come_back_to_rest(phase: Phase) -> None:
    seen, frontier = {phase}, [phase]
    while frontier:
        for following in TRANSITIONS[frontier.pop()].values():
            if following not in seen:
                seen.add(following)
                frontier.append(following)
    assert seen == set(Phase)


@dataclass(frozen=True)
class There(Strategy):
    """Fixed waypoints."""

    waypoints: tuple[Waypoint, ...] = (Waypoint(rad(30.0), "rotate"),)

    def next(self, task: Task, history: History) -> Waypoint | None:
        done = len(history) - 1
        return self.waypoints[done] if done < len(self.waypoints) else None

    def expected_motions(self) -> int:
        return len(self.waypoints)


TASK = Task(
    target_rad=rad(30.0),
    layout=EXPERIMENT_LAYOUT,
    torsional_rigidity_nm2=62.56e-6,
    speed_rad_s=rad(45.0),
    settle_s=1.0,
    angle_limit_rad=rad(90.0),
)
TICK_S = 0.01


class Bench:
    """Steps a sequence with a base that does what the test says."""

    def __init__(
        self, strategy: Strategy | None = None, task: Task = TASK, think: Think = think_at_once
    ) -> None:
        self.sequence = Sequence(
            task, strategy or There(), still_rad=rad(0.1), window_s=0.5, timeout_s=5.0, think=think
        )
        self.phase = Phase.REST
        self.time_s = 0.0
        self.base_deg = 0.0
        self.torque_nm = 0.0

    def step(self, dt_s: float = TICK_S) -> Event | None:
        self.time_s += dt_s
        halls = (rad(self.base_deg) / 2,) * 4
        measurement = Measurement(self.time_s, rad(self.base_deg), self.torque_nm, halls)
        event = self.sequence.step(self.phase, measurement, dt_s)
        if event is not None:
            self.phase = after(self.phase, event)
        return event

    def until(self, phase: Phase, limit_s: float = 60.0) -> float:
        start = self.time_s
        while self.phase is not phase:
            self.step()
            assert self.time_s - start < limit_s, f"still {self.phase} after {limit_s} s"
        return self.time_s - start


def test_a_motion_rests_moves_settles_measures_in_turn_and_takes_its_time() -> None:
    bench = Bench()
    assert bench.until(Phase.MOVING) == pytest.approx(0.5, abs=2 * TICK_S)
    assert bench.sequence.setpoint_rad == rad(30.0)
    for _ in range(100):
        bench.step()
    assert now(bench.phase) is Phase.MOVING
    bench.base_deg = 29.95
    bench.step()
    assert bench.phase is Phase.SETTLING
    assert bench.until(Phase.MEASURING) == pytest.approx(1.0, abs=2 * TICK_S)
    assert bench.until(Phase.DONE) == pytest.approx(0.5, abs=2 * TICK_S)


def test_the_torque_is_the_mean_over_the_window_and_nothing_before_it() -> None:
    bench = Bench()
    bench.until(Phase.MOVING)
    bench.base_deg, bench.torque_nm = 30.0, 5.0
    bench.until(Phase.MEASURING)
    sign = 1.0
    while bench.phase is Phase.MEASURING:
        sign = -sign
        bench.torque_nm = 1e-4 + sign * 5e-5
        bench.step()
    settled = bench.sequence.history[1]
    assert settled.torque_nm == pytest.approx(1e-4, rel=0.03)
    assert settled.name == "rotate"
    assert settled.predicted_lag_rad == pytest.approx(settled.torque_nm * 0.285 / 62.56e-6)
    assert settled.base_angle_rad == pytest.approx(rad(30.0))
    assert settled.tip_lag_rad == pytest.approx(rad(15.0))
    assert settled.moved_s == pytest.approx(0.5, abs=2 * TICK_S)
    assert settled.time_s == pytest.approx(bench.time_s)


def test_the_mean_weighs_ticks_by_their_length() -> None:
    bench = Bench()
    bench.until(Phase.MOVING)
    bench.base_deg = 30.0
    bench.until(Phase.MEASURING)
    bench.torque_nm = 1e-4
    bench.step(dt_s=0.4)
    bench.torque_nm = 0.0
    bench.step(dt_s=0.1)
    assert bench.sequence.history[1].torque_nm == pytest.approx(0.8e-4)


def test_the_rest_before_the_first_motion_is_the_first_of_the_history() -> None:
    bench = Bench()
    bench.torque_nm = 3e-5
    bench.until(Phase.MOVING)
    (rest,) = bench.sequence.history
    assert (rest.index, rest.name) == (0, "rest")
    assert rest.torque_nm == pytest.approx(3e-5)


def test_a_base_that_still_creeps_does_not_settle() -> None:
    bench = Bench()
    bench.until(Phase.MOVING)
    bench.base_deg = 29.95
    bench.step()
    for tick in range(400):
        bench.base_deg = 29.95 + 0.15 * (tick % 2)
        bench.step()
        assert bench.phase is Phase.SETTLING
    assert bench.until(Phase.MEASURING) == pytest.approx(0.5, abs=3 * TICK_S)


def test_a_base_that_moves_while_the_torque_is_read_goes_back_to_settling() -> None:
    bench = Bench()
    bench.until(Phase.MOVING)
    bench.base_deg = 30.0
    bench.until(Phase.MEASURING)
    bench.base_deg = 30.2
    assert bench.step() is Event.DISTURBED
    assert bench.phase is Phase.SETTLING
    bench.torque_nm = 7e-5
    bench.until(Phase.DONE)
    assert bench.sequence.history[1].torque_nm == pytest.approx(7e-5)


def test_a_base_that_never_becomes_still_is_told_after_the_timeout() -> None:
    bench = Bench()
    bench.until(Phase.MOVING)
    bench.base_deg = 30.0
    start = bench.time_s
    while bench.sequence.overdue() is None:
        bench.base_deg = 29.95 if bench.base_deg == 30.2 else 30.2
        bench.step()
        assert bench.time_s - start < 10.0
    # travel 30/45 s + settle 1 s + timeout 5 s
    assert bench.time_s - start == pytest.approx(30 / 45 + 1.0 + 5.0, abs=0.05)
    overdue = bench.sequence.overdue() or ""
    assert "it still moves by 0.25°" in overdue
    assert "limit 0.1° (sequence.still_deg)" in overdue


def test_a_base_that_never_arrives_is_told_too() -> None:
    bench = Bench()
    bench.until(Phase.MOVING)
    while bench.sequence.overdue() is None:
        bench.step()
    assert bench.phase is Phase.MOVING


def test_a_settled_motion_carries_its_name_its_reason_and_the_lag_that_its_torque_stands_for() -> None:
    waypoint = Waypoint(rad(30.0), "back", reason=Reason.MODEL_DOUBTED)
    means: dict[str, Any] = {"base_angle_rad": 0.5, "torque_nm": 1e-4, "hall_rad": (0.4, 0.3)}
    motion = settled_motion(TASK, waypoint, index=2, moved_s=1.0, time_s=4.0, **means)
    assert (motion.index, motion.name, motion.reason) == (2, "back", Reason.MODEL_DOUBTED)
    assert motion.waypoint_rad == rad(30.0)
    assert motion.tip_lag_rad == pytest.approx(0.2)
    # Reed 2008, (9): 285 mm of the experiment's layout stand for the whole shaft
    assert motion.predicted_lag_rad == pytest.approx(1e-4 / 62.56e-6 * 0.285)
    rest = settled_motion(TASK, None, index=0, moved_s=0.0, time_s=0.5, **means | {"hall_rad": ()})
    assert (rest.name, rest.reason, rest.waypoint_rad) == ("rest", Reason.STRATEGY, 0.5)
    assert math.isnan(rest.tip_lag_rad)


def test_a_waypoint_has_its_own_speed_and_settling_time() -> None:
    bench = Bench(There((Waypoint(rad(30.0), "step_1", speed_rad_s=0.2, settle_s=0.7),)))
    assert bench.sequence.speed_rad_s == TASK.speed_rad_s
    bench.until(Phase.MOVING)
    assert bench.sequence.speed_rad_s == 0.2
    bench.base_deg = 30.0
    bench.step()
    assert bench.until(Phase.MEASURING) == pytest.approx(0.7, abs=2 * TICK_S)


@pytest.mark.parametrize("angle", [rad(90.1), -rad(90.1), 1e300])
def test_a_waypoint_beyond_the_drive_s_angle_is_refused_by_name(angle: float) -> None:
    bench = Bench(There((Waypoint(angle, "step_1"),)))
    with pytest.raises(BadInput, match=r"motion step_1, outside ±90°"):
        bench.until(Phase.MOVING)


def setpoint_rad(bench: Bench) -> float:
    setpoint = bench.sequence.setpoint_rad
    assert setpoint is not None
    return setpoint


def test_dither_oscillates_about_the_waypoint_and_dies_away_before_the_base_has_arrived() -> None:
    bench = Bench(There((Waypoint(rad(30.0), "rotate", dither=Dither(rad(2.0), 2.0)),)))
    bench.until(Phase.MOVING)
    bench.base_deg = 30.0
    offsets = []
    while bench.phase is Phase.MOVING:
        bench.step()
        offsets.append(setpoint_rad(bench) - rad(30.0))
    assert max(offsets) == pytest.approx(rad(2.0), rel=0.05)
    assert min(offsets) == pytest.approx(-rad(2.0), rel=0.05)
    assert abs(offsets[-1]) <= rad(0.1)


def test_the_dither_s_velocity_is_the_slope_of_its_angle() -> None:
    bench = Bench(There((Waypoint(rad(30.0), "rotate", dither=Dither(rad(2.0), 2.0)),)))
    bench.until(Phase.MOVING)
    small = 1e-5
    for _ in range(30):
        bench.step()
        before, slope = setpoint_rad(bench), bench.sequence.feedforward_rad_s
        bench.step(small)
        assert (setpoint_rad(bench) - before) / small == pytest.approx(slope, abs=1e-3)


def test_progress_runs_from_nothing_to_one_and_never_falls() -> None:
    bench = Bench(There((Waypoint(rad(30.0), "a"), Waypoint(rad(-10.0), "b"))))
    told = [bench.sequence.progress(bench.phase)]
    while bench.phase is not Phase.DONE:
        if bench.phase is Phase.MOVING:
            waypoint = bench.sequence.waypoint
            assert waypoint is not None
            bench.base_deg = math.degrees(waypoint.angle_rad)
        bench.step()
        told.append(bench.sequence.progress(bench.phase))
    assert told[0] == 0.0
    assert told[-1] == 1.0
    assert told == sorted(told)
    assert all(after_ - before < 0.3 for before, after_ in itertools.pairwise(told))


def test_every_active_phase_says_what_it_waits_for_and_counts_down() -> None:
    bench = Bench()
    seen: dict[Phase, list[tuple[str, float | None]]] = {}
    while bench.phase is not Phase.DONE:
        if bench.phase is Phase.MOVING and bench.time_s > 1.0:
            bench.base_deg = 30.0
        text, left = bench.sequence.waiting(bench.phase)
        seen.setdefault(bench.phase, []).append((text, left))
        bench.step()
    assert set(seen) == ACTIVE - {Phase.HOLDING}
    assert seen[Phase.MOVING][0][0] == "the base to reach 30.0°"
    for rows in seen.values():
        assert rows[0][0]
        lefts = [known(left) for _, left in rows]
        assert lefts == sorted(lefts, reverse=True)


def test_the_base_holds_while_a_strategy_thinks() -> None:
    asked: list[Future[Waypoint | None]] = []

    def think(strategy: Strategy, task: Task, history: History) -> Future[Waypoint | None]:
        asked.append(Future())
        return asked[-1]

    bench = Bench(think=think)
    while not asked:
        bench.step()
    for _ in range(100):
        assert bench.step() is None
    assert bench.phase is Phase.REST
    assert bench.sequence.setpoint_rad == 0.0
    assert bench.sequence.waiting(bench.phase) == ("strategy There to plan the next motion", None)
    assert bench.sequence.waiting(Phase.ABORTED) == ("", None)
    assert len(bench.sequence.history) == 1
    asked[0].set_result(Waypoint(rad(20.0), "step_1"))
    assert bench.step() is Event.NEXT
    assert bench.sequence.setpoint_rad == rad(20.0)
    assert len(asked) == 1


def test_what_a_strategy_raises_comes_out_where_it_was_asked() -> None:
    def think(strategy: Strategy, task: Task, history: History) -> Future[Waypoint | None]:
        answer: Future[Waypoint | None] = Future()
        answer.set_exception(BadInput("no plan"))
        return answer

    bench = Bench(think=think)
    with pytest.raises(BadInput, match="no plan"):
        bench.until(Phase.MOVING)


def test_a_strategy_with_a_mistake_in_it_becomes_a_sentence() -> None:
    @dataclass(frozen=True)
    class Broken(There):
        def next(self, task: Task, history: History) -> Waypoint | None:
            raise ZeroDivisionError("division by zero")

    bench = Bench(Broken())
    with pytest.raises(RigFault, match=r"failed with ZeroDivisionError: division by zero; choose another"):
        bench.until(Phase.MOVING)


def test_the_time_that_a_strategy_thinks_is_not_the_base_s() -> None:
    bench = Bench(think=lambda *_: Future())
    for _ in range(1000):
        bench.step()
    assert bench.sequence.overdue() is None


def test_an_answer_from_elsewhere_counts_at_the_next_tick_however_soon_it_comes() -> None:
    def think(strategy: Strategy, task: Task, history: History) -> Future[Waypoint | None]:
        answer: Future[Waypoint | None] = Future()
        answer.set_result(strategy.next(task, history))
        return answer

    at_once, later = Bench(), Bench(think=think)
    assert later.until(Phase.MOVING) == pytest.approx(at_once.until(Phase.MOVING) + TICK_S)
