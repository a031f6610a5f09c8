"""What the bench does between its steps: it sleeps on at rest alone, and loses no step and no order by it."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.records import STOP, DriveState
from needle_rig.simulation.bench.bench_lines import Said
from needle_rig.simulation.bench.bench_loop import BenchLoop
from needle_rig.simulation.build import build_plant
from needle_rig.wire.can_frames import DRIVE_COMMAND_ID, DriveStatus, TorqueStatus
from needle_rig.wire.slcan import SlcanStream, slcan_line

CLEAR = dataclasses.replace(STOP, clear=True)


@pytest.fixture
def loop(tmp_path: Path) -> Iterator[BenchLoop]:
    said: list[Said] = []
    config = load_rig_config()
    made = BenchLoop(config, build_plant(config), tmp_path, said.append)
    yield made
    made.close()


def test_it_sleeps_on_at_rest_alone(loop: BenchLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    loop._now_us += 1000
    loop._step()
    assert loop._rest_s == pytest.approx(0.007)
    with monkeypatch.context() as running:
        running.setattr(loop._drive.guard, "state", DriveState.RUNNING)  # type: ignore[attr-defined]
        assert loop._rest_s == 0.0
    loop._by_hand_rad = 0.1
    assert loop._rest_s == 0.0
    loop._now_us += 1000
    loop._step()
    loop._by_hand_rad = 0.0
    assert loop._rest_s == 0.0  # it has just moved
    for _ in range(2000):  # the motor runs down
        loop._now_us += 1000
        loop._step()
    assert loop._rest_s == pytest.approx(0.007)


def test_every_step_is_sent_and_commands_come_at_their_time(loop: BenchLoop) -> None:
    heard: list[tuple[int, int]] = []
    receive, step = loop._drive.receive, loop._drive.step
    loop._drive.receive = lambda now_us, *frame: (heard.append((0, now_us)), receive(now_us, *frame))[1]  # type: ignore[method-assign, func-returns-value]
    loop._drive.step = lambda now_us, *given, **named: (  # type: ignore[method-assign]
        heard.append((1, now_us)),  # type: ignore[func-returns-value]
        step(now_us, *given, **named),
    )[1]
    control, ending = os.pipe()
    thread = threading.Thread(target=loop.run, args=(control,))
    terminal = os.open(loop.ports["can"], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    os.write(terminal, b"O\r")
    thread.start()
    got = b""
    for count in range(1, 61):
        data = loop._codec.encode_command(CLEAR, count, count)
        os.write(terminal, slcan_line(DRIVE_COMMAND_ID, data))
        time.sleep(0.005)
        try:
            got += os.read(terminal, 65536)
        except BlockingIOError:
            continue
    os.close(ending)
    thread.join(5.0)
    os.close(terminal)
    os.close(control)
    frames = [loop._codec.decode(*frame) for frame in SlcanStream().feed(got)]
    for kind in (TorqueStatus, DriveStatus):
        counters = [frame.counter for frame in frames if isinstance(frame, kind)]
        assert len(counters) > 100
        assert all((b - a) % 16 == 1 for a, b in itertools.pairwise(counters))
    times = [at for _, at in heard]
    assert len([1 for kind, _ in heard if kind == 0]) > 100
    assert all(a <= b for a, b in itertools.pairwise(times))


@pytest.mark.parametrize(("asleep_s", "in_a_step_s"), [(0.029, 0.0), (0.2, 0.0), (0.0, 0.029), (0.0, 0.2)])
def test_a_bench_that_is_late_hears_its_host_before_a_drive_blames_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asleep_s: float, in_a_step_s: float
) -> None:
    """Host and bench wake up every 10 ms; the machine pauses each tenth time."""
    config = load_rig_config(None, {"simulation.sensor_rate_hz": 100})
    loop = BenchLoop(config, build_plant(config), tmp_path, lambda said: None)
    now_s, step = 100.0, loop._step
    heard_us: list[int] = []
    ages_s: list[float] = []

    def hear(now_us: int, frame_id: int, data: bytes) -> None:
        if frame_id == DRIVE_COMMAND_ID:
            heard_us.append(now_us)

    def stepped() -> None:
        nonlocal now_s
        ages_s.append((loop._now_us - (heard_us or [0])[-1]) * 1e-6)
        if len(ages_s) % 10 == 0:
            now_s += in_a_step_s
        step()

    def wake(watched: list[object], _: object, __: object, sleep_s: float) -> tuple[list[object], ...]:
        nonlocal now_s
        if len(ages_s) > 200:
            raise InterruptedError
        now_s += sleep_s + asleep_s * (len(ages_s) % 10 == 1)
        return [loop._can_port], [], []

    frame = (DRIVE_COMMAND_ID, loop._codec.encode_command(CLEAR, 1, 1))
    monkeypatch.setattr(loop, "_step", stepped)
    monkeypatch.setattr(loop._drive, "receive", hear)
    monkeypatch.setattr(loop._can_port, "receive", lambda: [frame])
    monkeypatch.setattr("needle_rig.simulation.bench.bench_loop.select.select", wake)
    monkeypatch.setattr("needle_rig.simulation.bench.bench_loop.time.monotonic", lambda: now_s)
    with contextlib.closing(loop), pytest.raises(InterruptedError):
        loop.run(0)
    assert min(ages_s) >= 0.0
    assert max(ages_s) <= 0.0101  # no more than from tick to tick: 0.05 s stops a drive
