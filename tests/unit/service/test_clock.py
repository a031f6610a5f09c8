import asyncio
import time

import pytest

from needle_rig.service.tick.clock import TimerClock, VirtualClock

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


async def test_closing_twice_and_cancelling_leave_nothing_behind() -> None:
    clock = TimerClock(10.0)
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
