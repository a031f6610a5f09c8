"""The motion monitor: what it takes for wrong, to the last unit, and what the shaft does meanwhile."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

import pytest

from needle_rig.firmware.host import HostNodes
from needle_rig.records import DriveFault, DriveState
from tests.firmware.shaft import Shaft

FOLLOWS, STALLS, RUNS, AGAINST, UNASKED = 0, 1, 2, 4, 8
MOTION = DriveFault.STALL | DriveFault.RUNAWAY | DriveFault.DIRECTION | DriveFault.IDLE_MOTION
BOUND_DEG = 5.0


class Monitor:
    """A monitor with the drive's limits, a shaft that is put where it is wanted."""

    def __init__(self, nodes: HostNodes) -> None:
        self.lib = nodes.lib
        self.c: Any = nodes.ffi.new("struct nr_motion *")
        self.config: Any = nodes.ffi.addressof(nodes.lib.nr_drive_defaults.guard, "motion")
        self.angle_mdeg = 0
        self.lib.nr_motion_rest(self.c, 0)

    def step(self, asked: int, moved_mdeg: int = 0, elapsed_us: int = 1000) -> int:
        self.angle_mdeg += moved_mdeg
        return int(self.lib.nr_motion_step(self.c, self.config, elapsed_us, self.angle_mdeg, asked))

    def steady(self, asked: int) -> Monitor:
        """Turning as asked for long, in steps of 20 ms, in which `asked` turns whole mdeg."""
        for _ in range(40):
            assert self.step(asked, asked // 500, 20_000) == FOLLOWS
        self.c.following = 0
        return self


@pytest.mark.parametrize("way", [-1, 1])
@pytest.mark.parametrize("speed", [1000, 10_000, 450_000])
@pytest.mark.parametrize("off", [-1, 0, 1])
def test_behind_and_ahead_to_the_last_unit(nodes: HostNodes, way: int, speed: int, off: int) -> None:
    limit = 250 * 10**7 + speed * 50_000
    for sign, wrong in ((1, STALLS), (-1, RUNS)):
        monitor = Monitor(nodes).steady(way * speed)
        monitor.c.following = sign * way * (limit + off)
        assert monitor.step(way * speed, way * speed // 500, 20_000) == (wrong if off > 0 else FOLLOWS)


@pytest.mark.parametrize("way", [-1, 1])
@pytest.mark.parametrize("off", [-1, 0, 1])
def test_too_fast_to_the_last_unit(nodes: HostNodes, way: int, off: int) -> None:
    monitor = Monitor(nodes).steady(10_000)
    fastest = 13_000 + 150_000  # of 5 ms: 81.5 mdeg
    assert (
        monitor.config.speed_floor + monitor.c.pace_q8 // 256 * monitor.config.speed_percent // 100 == fastest
    )
    moved_us = 10**7 * 163 // (fastest + off)
    monitor.c.following = 0
    verdict = monitor.step(10_000, way * 163, moved_us)
    turned = 163 * 10**7 // moved_us
    assert (turned > fastest) == (off > 0)
    assert verdict == (FOLLOWS if off <= 0 else RUNS if way > 0 else AGAINST)


@pytest.mark.parametrize("way", [-1, 1])
@pytest.mark.parametrize(("back", "verdict"), [(5500, STALLS), (5501, AGAINST)])
def test_behind_is_named_by_how_the_shaft_turns(nodes: HostNodes, way: int, back: int, verdict: int) -> None:
    monitor = Monitor(nodes).steady(way * 10_000)
    monitor.c.following = way * 10**10
    monitor.c.turning = -way * back
    assert monitor.step(way * 10_000, 0, 0) == verdict


def test_what_is_behind_when_nothing_is_expected_runs(nodes: HostNodes) -> None:
    for following in (-(10**10), 10**10):
        monitor = Monitor(nodes).steady(10_000)
        monitor.c.expected_q8, monitor.c.following = 0, following
        assert monitor.step(0, 0, 0) == RUNS


@pytest.mark.parametrize("off_us", [-1, 0, 1])
def test_the_motor_rests_once_nothing_was_asked_for_long(nodes: HostNodes, off_us: int) -> None:
    monitor = Monitor(nodes).steady(10_000)
    monitor.step(0, 0, 50_000 + off_us)
    monitor.c.following = 10**8
    monitor.step(0, 0, 50_000)
    assert monitor.c.resting == (off_us >= 0)
    assert (monitor.c.following == 0) == (off_us >= 0)
    monitor.step(1, 0)
    assert not monitor.c.resting
    monitor.step(0, 0, 99_999)
    assert not monitor.c.resting, "what is asked starts the time anew"


@pytest.mark.parametrize("way", [-1, 1])
@pytest.mark.parametrize("off_mdeg", [-1, 0, 1])
def test_a_hand_may_touch_a_motor_at_rest(nodes: HostNodes, way: int, off_mdeg: int) -> None:
    monitor = Monitor(nodes)
    verdicts = [monitor.step(0, way * 500), monitor.step(0, way * (500 + off_mdeg))]
    assert verdicts == [FOLLOWS, UNASKED if off_mdeg > 0 else FOLLOWS]
    assert monitor.step(0, -way * 500) == FOLLOWS
    assert monitor.step(0, 0, 5000) == FOLLOWS
    assert monitor.step(1, 0) == FOLLOWS
    assert abs(monitor.c.following) < 100, "what was forgiven is not held against the next motion"


def test_expectation_and_pace_take_their_time(nodes: HostNodes) -> None:
    monitor = Monitor(nodes)
    monitor.step(200_000, 0, 1000)
    assert monitor.c.expected_q8 == 200_000 * 256 // 20
    assert monitor.c.pace_q8 == 200_000 * 256
    assert monitor.c.following == 200_000 // 20 * 1000
    monitor.step(-100_000, 0, 4000)
    assert monitor.c.expected_q8 == 256 * (10_000 - 110_000 // 5)
    assert monitor.c.pace_q8 == 256 * 198_000
    monitor.step(0, 0, 20_000)
    assert monitor.c.expected_q8 == 0
    monitor.step(0, 0, 400_000)
    assert monitor.c.pace_q8 == 0


def test_speed_is_smoothed_over_5_ms(nodes: HostNodes) -> None:
    monitor = Monitor(nodes).steady(10_000)
    monitor.c.turning = 0
    monitor.step(10_000, 10, 1000)
    assert monitor.c.turning == 10 * 10**7 // 1000 // 5
    monitor.step(10_000, 10, 5000)
    assert monitor.c.turning == 10 * 10**7 // 5000
    before = monitor.c.turning
    monitor.step(10_000, 10, 0)
    assert monitor.c.turning == before


@pytest.mark.parametrize("jump_mdeg", [2**31 - 1, -(2**31), 1_000_001, -1_000_001])
def test_an_impossible_jump_is_cut_and_wrong(nodes: HostNodes, jump_mdeg: int) -> None:
    monitor = Monitor(nodes).steady(10_000)
    monitor.angle_mdeg = 0
    monitor.c.angle_mdeg = 0
    assert monitor.step(10_000, jump_mdeg, 1) != FOLLOWS
    assert abs(monitor.c.following) <= 10**13 + 10**6


@pytest.mark.parametrize(("jump_mdeg", "cut_mdeg"), [(999_999, 999_999), (10**6, 10**6), (10**6 + 1, 10**6)])
@pytest.mark.parametrize("way", [-1, 1])
def test_a_jump_is_cut_to_the_last_unit(nodes: HostNodes, jump_mdeg: int, cut_mdeg: int, way: int) -> None:
    monitor = Monitor(nodes)
    monitor.step(0, way * jump_mdeg, 1)
    assert monitor.c.following == -way * cut_mdeg * 10**7
    assert monitor.c.turning == way * cut_mdeg * 10**7 // 5000


def test_a_new_name_for_the_place_is_no_motion(nodes: HostNodes) -> None:
    monitor = Monitor(nodes)
    monitor.lib.nr_motion_rename(monitor.c, 45_000)
    monitor.angle_mdeg = 45_000
    assert monitor.step(0) == FOLLOWS
    assert monitor.c.following == 0


def stuck(shaft: Shaft) -> None:
    shaft.encoder_stuck = True


def reversed_encoder(shaft: Shaft) -> None:
    shaft.encoder_gain = -1.0


def reversed_motor(shaft: Shaft) -> None:
    shaft.gain = -shaft.gain


def dead_motor(shaft: Shaft) -> None:
    shaft.gain = 0.0


def slips(shaft: Shaft) -> None:
    shaft.gain *= 0.15


def too_fast(shaft: Shaft) -> None:
    shaft.shorted_deg_s = 110.0


def shorted(shaft: Shaft) -> None:
    shaft.shorted_deg_s = 180.0


HARMS: dict[Callable[[Shaft], None], DriveFault] = {
    stuck: DriveFault.STALL,
    reversed_encoder: MOTION,
    reversed_motor: MOTION,
    dead_motor: MOTION,
    slips: MOTION,
    too_fast: MOTION,
    shorted: MOTION,
}
SPEEDS_DEG_S = (0.1, 0.3, 1.0, 3.0, 9.0, 20.0, 45.0, 60.0, 90.0)


def harmed(nodes: HostNodes, harm: Callable[[Shaft], None], speed_deg_s: float, rng: random.Random) -> Shaft:
    """A move at `speed_deg_s` in which something breaks, on a motor of the range that is served."""
    shaft = Shaft(
        nodes,
        gain=rng.choice((0.7, 1.0, 1.3)),
        torque_nmm=rng.choice((-0.2, 0.0, 0.2)),
        droop_deg_s_per_nmm=rng.choice((0.0, 1.0)),
    ).ready()
    way = rng.choice((-1, 1))
    shaft.turning(way * speed_deg_s).run(rng.choice((0, rng.randrange(150), rng.randrange(900))))
    harm(shaft)
    shaft.until_fault(round(1500 + 600 / speed_deg_s))
    return shaft


def campaign(nodes: HostNodes, trials: int) -> None:
    rng = random.Random(1)
    for harm, names in HARMS.items():
        for speed_deg_s in SPEEDS_DEG_S:
            for _ in range(trials):
                shaft = harmed(nodes, harm, speed_deg_s, rng)
                assert shaft.beyond_deg < BOUND_DEG, (harm.__name__, speed_deg_s, shaft)
                served = harm is slips and abs(shaft.asked_deg - shaft.true_deg) < 0.25
                assert shaft.faults & names or served, (harm.__name__, speed_deg_s, shaft.faults)
                assert not shaft.supply or served


def test_whatever_breaks_at_any_speed_the_shaft_stays_within_5_degrees(nodes: HostNodes) -> None:
    campaign(nodes, 2)


@pytest.mark.slow
def test_whatever_breaks_again_and_again(nodes: HostNodes) -> None:
    campaign(nodes, 60)


@pytest.mark.parametrize("speed_deg_s", [0.0, 1.0, 20.0, 45.0, 60.0])
@pytest.mark.parametrize("way", [-1, 1])
def test_a_shorted_power_stage_loses_its_supply_within_20_ms(
    nodes: HostNodes, speed_deg_s: float, way: int
) -> None:
    for ran_ms in (0, 20, 90, 150, 400):
        shaft = Shaft(nodes, gain=1.3).ready().turning(speed_deg_s).run(ran_ms)
        shaft.shorted_deg_s = way * 180.0
        start_ms = shaft.ms
        while shaft.supply and shaft.ms - start_ms < 100:
            shaft.run(1)
        assert shaft.ms - start_ms <= 20
        shaft.run(200)
        assert shaft.beyond_deg < BOUND_DEG


@pytest.mark.parametrize("drift_deg_s", [3.0, 20.0, 180.0])
def test_what_moves_while_idle_loses_its_supply(nodes: HostNodes, drift_deg_s: float) -> None:
    shaft = Shaft(nodes).ready()
    shaft.shorted_deg_s = drift_deg_s
    assert shaft.until_fault(2000) is not None
    assert shaft.faults == DriveFault.IDLE_MOTION
    assert shaft.beyond_deg < BOUND_DEG


def until_400_ms(speed_deg_s: float) -> Callable[[int], float]:
    return lambda ms: speed_deg_s if ms < 400 else 0.0


@pytest.mark.whole
def test_a_stuck_encoder_while_almost_nothing_is_asked_does_not_creep(nodes: HostNodes) -> None:
    """A motion whose last part an encoder that stands still does not see; then nothing for a minute."""
    for speed_deg_s in (1.0, 10.0, 60.0):
        for last_ms in (5, 20, 40):
            shaft = Shaft(nodes, gain=1.3, droop_deg_s_per_nmm=0.0, torque_nmm=0.2).ready()
            shaft.turning(until_400_ms(speed_deg_s)).run(400 - last_ms)
            shaft.encoder_stuck = True
            shaft.run(1000)
            before_deg = shaft.true_deg
            shaft.run(60_000)
            assert shaft.true_deg == pytest.approx(before_deg, abs=1e-3)
            assert shaft.beyond_deg < BOUND_DEG


LAGS = ((0.002, 0), (0.010, 2), (0.030, 6), (0.040, 10))


def profile(rng: random.Random, speed_deg_s: float) -> Callable[[int], float]:
    """What a host may ask for: steps, reversals, pulses, dither, ramps at its acceleration limit."""
    kind = rng.choice(("step", "reverse", "pulses", "sine", "random", "ramps"))
    period_ms, rate_hz = rng.randrange(40, 700), rng.uniform(0.5, 9.0)
    if kind == "step":
        return lambda ms: speed_deg_s if ms < 2 * period_ms else 0.0
    if kind == "reverse":
        return lambda ms: speed_deg_s if ms // period_ms % 2 else -speed_deg_s
    if kind == "pulses":
        return lambda ms: speed_deg_s if ms // period_ms % 2 else 0.0
    if kind == "sine":
        return lambda ms: speed_deg_s * math.sin(math.tau * rate_hz * ms * 1e-3)
    asked: list[float] = [0.0]
    while len(asked) < 3000:
        goal = rng.uniform(-speed_deg_s, speed_deg_s)
        for _ in range(rng.randrange(20, 500)):
            step = goal - asked[-1]
            asked.append(goal if kind == "random" else asked[-1] + min(max(step, -0.36), 0.36))
    return lambda ms: asked[ms]


def up_to(late_ms: int, rng: random.Random) -> Callable[[int], int]:
    return lambda _ms: rng.randrange(late_ms + 1)


def nuisance(nodes: HostNodes, trials: int) -> None:
    rng = random.Random(2)
    for _ in range(trials):
        lag_s, delay_ms = rng.choice(LAGS)
        late_ms = rng.choice((0, 0, 4, 15))
        shaft = Shaft(
            nodes,
            gain=rng.choice((0.7, 1.0, 1.3)),
            time_constant_s=lag_s,
            delay_ms=delay_ms,
            torque_nmm=rng.choice((-2.0, -1.0, 0.0, 0.2, 2.0)),
            period_ms=rng.choice((1, 5, 10, 20)),
            jitter=up_to(late_ms, rng),
        ).ready()
        shaft.turning(profile(rng, rng.choice((0.1, 1.0, 5.0, 20.0, 45.0, 60.0, 90.0)))).run(1500)
        shaft.enable = False
        shaft.run(rng.randrange(1, 400))
        shaft.enable = True
        shaft.run(500)
        assert shaft.state is DriveState.RUNNING, shaft


def test_no_healthy_motor_trips(nodes: HostNodes) -> None:
    nuisance(nodes, 80)


@pytest.mark.slow
def test_no_healthy_motor_trips_in_thousands_of_motions(nodes: HostNodes) -> None:
    nuisance(nodes, 5000)
