"""What the bench does between its steps: it sleeps on at rest alone, and loses no step and no order by it."""

from __future__ import annotations

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
