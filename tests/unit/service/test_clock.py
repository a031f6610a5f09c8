import asyncio
import itertools
import time
from collections.abc import Callable

import pytest

from needle_rig.service.clock import Clock, Pace, SensorClock, TimerClock, VirtualClock

PERIOD_S = 0.004


@pytest.mark.real_time
async def test_ticks_keep_to_absolute_deadlines() -> None:
    clock = TimerClock(PERIOD_S)
    try:
        passed = 1 + await clock.tick(busy=True)
        start_s = clock.now_s() - clock.lateness_s
        passed = 0
        for _ in range(50):
            passed += 1 + await clock.tick(busy=True)
        # whatever the lateness of each tick, the sum has not drifted
        due_s = start_s + passed * PERIOD_S
        assert clock.now_s() - clock.lateness_s == pytest.approx(due_s, abs=2e-3)
        assert clock.lateness_s >= 0.0
    finally:
        clock.close()


@pytest.mark.real_time
async def test_skipped_ticks_are_counted_and_not_made_up_for() -> None:
    clock = TimerClock(PERIOD_S)
    try:
        await clock.tick(busy=True)
        _block(3.5 * PERIOD_S)
        assert clock.overrun()
        assert await clock.tick(busy=True) >= 2
        assert clock.lateness_s < PERIOD_S or clock.overrun()
    finally:
        clock.close()


MS = 1_000_000


@pytest.mark.parametrize("readings_a_tick", [1, 2, 5])
@pytest.mark.parametrize("slower", [0.98, 1.02])
def test_ticks_keep_the_pace_of_the_readings_nearest_to_their_time(
    readings_a_tick: int, slower: float
) -> None:
    pace = Pace(4 * MS, 0)
    interval_ns = round(slower * 4 * MS / readings_a_tick)
    begun_ns = []
    for reading in range(1, 200 * readings_a_tick):
        at_ns = reading * interval_ns
        assert at_ns < pace.latest_ns, "no tick begins without a reading"
        if pace.heard(at_ns):
            begun_ns.append(at_ns)
            assert pace.begin(at_ns + 1000) == (1000, 0)
    apart_ns = {after - before for before, after in itertools.pairwise(begun_ns[100:])}
    assert apart_ns == {interval_ns * readings_a_tick}


def test_readings_that_come_now_early_now_late_are_each_followed() -> None:
    pace = Pace(4 * MS, 0)
    for reading in range(1, 50):
        at_ns = 4 * MS * reading + (MS if reading % 2 else 0)
        assert pace.heard(at_ns)
        assert pace.begin(at_ns) == (0, 0)


def test_without_readings_ticks_keep_their_own_time_and_tell_what_they_skip() -> None:
    pace = Pace(4 * MS, 0)
    assert pace.latest_ns == 6 * MS
    assert pace.begin(6 * MS) == (0, 0)
    assert pace.latest_ns == 10 * MS
    assert pace.begin(13 * MS) == (3 * MS, 0)
    assert pace.latest_ns == 14 * MS
    assert pace.begin(14 * MS + 9 * MS) == (MS, 2)
    assert pace.latest_ns == 26 * MS


def test_after_a_pause_its_first_reading_is_followed_and_the_next_deadline_is_near() -> None:
    pace = Pace(4 * MS, 0)
    assert pace.heard(50 * MS)
    assert pace.begin(51 * MS) == (MS, 11)
    assert pace.latest_ns <= (50 + 6) * MS
    # one that waited while this process did is as old as it is
    assert pace.heard(54 * MS)
    assert pace.begin(80 * MS) == (26 * MS, 6)
    assert 80 * MS < pace.latest_ns <= 86 * MS


def test_a_flood_of_readings_makes_no_more_ticks() -> None:
    pace = Pace(4 * MS, 0)
    ticks = 0
    for at_ns in range(0, 400 * MS, MS // 20):
        if pace.heard(at_ns):
            ticks += 1
            pace.begin(at_ns)
    assert 99 <= ticks <= 110


@pytest.mark.real_time
async def test_a_tick_begins_when_its_reading_comes_and_without_one_by_the_timer() -> None:
    clock = SensorClock(0.4)
    loop = asyncio.get_running_loop()
    clock.heard(clock.now_s())  # before the first tick: nobody follows it
    try:
        begun_s = clock.now_s()
        loop.call_later(0.3, lambda: clock.heard(clock.now_s()))
        assert await clock.tick(busy=True) == 0
        assert clock.now_s() - begun_s == pytest.approx(0.3, abs=0.05)
        assert clock.lateness_s < 0.05
        await clock.tick(busy=True)
        assert clock.now_s() - begun_s == pytest.approx(0.3 + 0.6, abs=0.05)
        assert not clock.overrun()
    finally:
        clock.close()


@pytest.mark.parametrize("made", [TimerClock, SensorClock])
async def test_closing_twice_and_cancelling_leave_nothing_behind(made: Callable[[float], Clock]) -> None:
    clock = made(10.0)
    waiting = asyncio.create_task(clock.tick(busy=True))
    await asyncio.sleep(0)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    clock.close()
    clock.close()


async def test_virtual_time_moves_only_while_somebody_is_busy() -> None:
    moved: list[float] = []
    clock = VirtualClock(PERIOD_S, moved.append)
    for _ in range(3):
        await clock.tick(busy=True)
    assert clock.now_s() == pytest.approx(3 * PERIOD_S)
    await clock.tick(busy=False)
    assert clock.now_s() == pytest.approx(3 * PERIOD_S)
    assert moved == [PERIOD_S] * 3
    assert not clock.overrun()


async def test_virtual_time_lets_others_run() -> None:
    clock = VirtualClock(PERIOD_S, lambda dt_s: _block(0.0005))
    turns = 0

    async def other() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    task = asyncio.create_task(other())
    for _ in range(40):
        await clock.tick(busy=True)
    task.cancel()
    assert turns >= 3


def _block(seconds: float) -> None:
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        pass
