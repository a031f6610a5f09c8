"""A terminal is read beside the loop: bytes with their time, an end told once, nothing left behind."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
import os
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from needle_rig.devices.serial_line import SerialLine
from needle_rig.devices.terminal_reader import TerminalReader
from needle_rig.simulation.nodes.slcan_hub import Pty


@pytest.fixture
def pair() -> Iterator[tuple[int, int]]:
    """Two ends of a pseudo-terminal: the adapter's and ours."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(theirs, False)
    ends = [ours, theirs]
    yield ours, theirs
    for end in ends:
        try:
            os.close(end)
        except OSError:
            continue


async def until(true: Callable[[], object]) -> None:
    async with asyncio.timeout(5.0):
        while not true():
            await asyncio.sleep(0.005)


async def test_what_comes_is_handed_on_by_the_loop_in_order_and_with_the_time_of_its_reading(
    pair: tuple[int, int],
) -> None:
    adapter, terminal = pair
    heard: list[tuple[bytes, float]] = []
    times = iter(range(1, 100))
    reader = TerminalReader(
        terminal, lambda data, now_s: heard.append((data, now_s)), lambda e: None, lambda: float(next(times))
    )
    os.write(adapter, b"one")
    await until(lambda: heard)
    os.write(adapter, b"two")
    await until(lambda: len(heard) == 2)
    reader.close()
    assert heard == [(b"one", 1.0), (b"two", 2.0)]


async def test_a_tick_takes_what_the_loop_has_not_brought(pair: tuple[int, int]) -> None:
    adapter, terminal = pair
    heard: list[bytes] = []
    reader = TerminalReader(terminal, lambda data, now_s: heard.append(data), lambda error: None)
    os.write(adapter, b"now")
    for _ in range(1000):
        threading.Event().wait(0.001)  # the loop does not run meanwhile
        reader.drain()
        if heard:
            break
    assert heard == [b"now"]
    reader.close()


async def test_who_drains_every_tick_has_it_read_once_a_tick_and_the_loop_left_alone(
    pair: tuple[int, int],
) -> None:
    adapter, terminal = pair
    ticks, writes = 30, 10
    heard: list[bytes] = []
    reader = TerminalReader(terminal, lambda data, now_s: heard.append(data), lambda e: None, tick_s=0.01)
    for _ in range(ticks):
        reader.drain()
        for _ in range(writes):
            os.write(adapter, b"x")
            time.sleep(0.001)
    with contextlib.suppress(BlockingIOError):
        assert os.eventfd_read(reader._came) < ticks * writes / 3
    await until(lambda: len(b"".join(heard)) == ticks * writes)
    reader.close()
    assert len(heard) < ticks * writes / 3


async def test_the_loop_takes_over_where_a_tick_stays_away(pair: tuple[int, int]) -> None:
    adapter, terminal = pair
    heard: list[bytes] = []
    reader = TerminalReader(terminal, lambda data, now_s: heard.append(data), lambda e: None, tick_s=0.005)
    for place, sent in enumerate((b"a", b"b", b"c"), 1):
        reader.drain()
        os.write(adapter, sent)
        await until(functools.partial(lambda count: len(b"".join(heard)) == count, place))
    reader.close()
    assert b"".join(heard) == b"abc"


@pytest.mark.parametrize(
    ("tick_s", "since_s", "pause_s"),
    [
        (0.005, 0.0, 0.004),
        (0.005, 0.003, 0.001),
        (0.005, 0.0045, 0.0045),
        (0.001, 0.0, 0.0008),
        (0.005, 0.011, None),
        (0.02, 0.0, None),
        (math.inf, 0.0, None),
    ],
)
async def test_it_reads_a_fifth_of_a_tick_before_the_next(
    pair: tuple[int, int],
    tick_s: float,
    since_s: float,
    pause_s: float | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reader = TerminalReader(pair[1], lambda data, now_s: None, lambda e: None, tick_s=tick_s)
    times = iter((100.0, 100.0 + since_s))
    with monkeypatch.context() as patched:
        patched.setattr("needle_rig.devices.terminal_reader.time.monotonic", lambda: next(times))
        reader.drain()
        found = reader._pause_s()
    reader.close()
    assert found == (None if pause_s is None else pytest.approx(pause_s, abs=1e-9))


async def test_a_terminal_that_hangs_up_is_told_once_after_its_last_bytes(pair: tuple[int, int]) -> None:
    adapter, terminal = pair
    told: list[object] = []
    reader = TerminalReader(terminal, lambda data, now_s: told.append(data), told.append)
    os.write(adapter, b"last")
    await until(lambda: told)
    os.close(adapter)
    await until(lambda: len(told) == 2)
    reader.drain()
    await asyncio.sleep(0.05)
    reader.close()
    assert told[0] == b"last"
    assert isinstance(told[1], OSError)
    assert len(told) == 2


async def test_closing_ends_the_thread_and_its_descriptors_and_may_be_done_twice(
    pair: tuple[int, int],
) -> None:
    _, terminal = pair
    before = len(os.listdir("/proc/self/fd")), threading.active_count()
    reader = TerminalReader(terminal, lambda data, now_s: None, lambda error: None)
    assert threading.active_count() == before[1] + 1
    reader.close()
    reader.close()
    assert (len(os.listdir("/proc/self/fd")), threading.active_count()) == before
    os.fstat(terminal)


async def test_it_has_the_scheduling_of_who_makes_it_one_priority_below(pair: tuple[int, int]) -> None:
    _, terminal = pair
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(20))
    except PermissionError:
        pytest.skip("no real-time priority here")
    try:
        reader = TerminalReader(terminal, lambda data, now_s: None, lambda error: None)
    finally:
        os.sched_setscheduler(0, *before)
    thread = next(each for each in threading.enumerate() if each.name == "terminal")
    assert thread.native_id is not None
    await until(lambda: os.sched_getscheduler(thread.native_id or 0) == os.SCHED_FIFO)
    assert os.sched_getparam(thread.native_id).sched_priority == 19
    reader.close()


async def test_a_serial_line_that_was_lost_is_opened_anew_and_leaves_nothing(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd")), threading.active_count()
    heard: list[bytes] = []
    place = tmp_path / "hall"
    line = SerialLine("hall", str(place), 921600, lambda data, now_s: heard.append(data))
    for sent in (b"one", b"two"):
        adapter = Pty()
        place.unlink(missing_ok=True)
        place.symlink_to(adapter.name)
        line.open()
        adapter.write(sent)
        adapter.flush()
        await until(functools.partial(heard.__contains__, sent))
        adapter.close()
        await until(lambda: line.lost)
        assert not line.send(b"x")
    await line.close()
    await line.close()
    assert (len(os.listdir("/proc/self/fd")), threading.active_count()) == before
