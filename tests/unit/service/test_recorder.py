import asyncio
import functools
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput, RigFault
from needle_rig.recording import RunFile, journal_path, list_runs, unfinished_runs
from needle_rig.records import DriveFault, DriveState, Phase, Sample
from needle_rig.service.recorder import recorder as recorder_module
from needle_rig.service.recorder.recorder import Recorder

REQUEST = {"strategy": "reed2008", "target_deg": 45.0, "parameters": "rig_elastic"}
HALLS = (0.1, 0.2, 0.3, 0.4)
SAMPLE = Sample(
    *(0.0, 0.005, Phase.MOVING, "rotate", 0.5, 1e-4, HALLS, 0.7, 0.2, True, False),
    *(DriveState.RUNNING, DriveFault.NONE, 0.001, 0.002, 0.003),
)


@pytest.fixture
def config() -> RigConfig:
    return load_rig_config()


async def test_every_tick_and_every_reading_reaches_the_file(config: RigConfig, tmp_path: Path) -> None:
    failures: list[str] = []
    recorder = Recorder(failures.append)
    await recorder.start(tmp_path)
    recorder.sample(SAMPLE)  # before a run: not recorded
    path = await recorder.begin(tmp_path, config, REQUEST)
    for n in range(1000):
        recorder.sample(replace(SAMPLE, time_s=n * 0.005))
        recorder.raw("torque", (n * 0.005, n * 0.005, n, 1e-4))
        recorder.raw("hall", (n * 0.005, n * 0.005, n, *HALLS))
        recorder.raw("drive", (n * 0.005, n * 0.005, n, 0.5, 2, 0))
    recorder.event(1.0, "phase", "rotate moving")
    await recorder.finish({"status": "aligned"}, 5.0)
    await recorder.close()
    await recorder.close()
    run = RunFile(path)
    assert run.complete
    assert run.result == {"status": "aligned"}
    assert {name: len(run.table(name)) for name in ("ticks", "torque", "hall", "drive")} == dict.fromkeys(
        ("ticks", "torque", "hall", "drive"), 1000
    )
    assert [event.kind for event in run.events] == ["phase", "end"]
    assert failures == []
    assert recorder.lost_rows == 0


async def test_a_run_that_never_began_leaves_no_file(config: RigConfig, tmp_path: Path) -> None:
    recorder = Recorder(lambda sentence: None)
    await recorder.start(tmp_path)
    path = await recorder.begin(tmp_path, config, REQUEST)
    await recorder.discard()
    assert not path.exists()
    await recorder.begin(tmp_path, config, REQUEST)
    await recorder.finish({}, 0.0)
    await recorder.close()
    assert len(list(tmp_path.iterdir())) == 1


@pytest.fixture
def failures() -> list[str]:
    return []


@pytest.fixture
def recorder(failures: list[str]) -> Recorder:
    return Recorder(failures.append)


def started(test: Callable[..., Awaitable[None]]) -> Callable[..., Awaitable[None]]:
    """`test` with its recorder started, and closed after it."""

    @functools.wraps(test)
    async def run(recorder: Recorder, tmp_path: Path, **rest: Any) -> None:
        await recorder.start(tmp_path)
        try:
            await test(recorder=recorder, tmp_path=tmp_path, **rest)
        finally:
            await recorder.close()

    return run


def process(recorder: Recorder) -> asyncio.subprocess.Process:
    return recorder._links[-1].process


def add_rows(recorder: Recorder, count: int, begin: int = 0) -> None:
    for n in range(begin, begin + count):
        recorder.raw("torque", (n * 0.005 + 1.0, n * 0.005, n, 1e-4))
        recorder.sample(replace(SAMPLE, time_s=n * 0.005 + 1.0))


async def until_told(recorder: Recorder, failures: list[str], begin: int = 0) -> None:
    """Rows at 200 Hz until the failure of the record is told."""
    for n in range(begin, begin + 4000):
        add_rows(recorder, 1, n)
        if failures:
            return
        await asyncio.sleep(0.005)
    raise AssertionError("nothing was told for 20 s")


async def assert_records(recorder: Recorder, folder: Path, config: RigConfig) -> None:
    """The next run is whole, and its file holds what its request asks for."""
    path = await recorder.begin(folder, config, {**REQUEST, "strategy": "relax"})
    add_rows(recorder, 20)
    await recorder.finish({"status": "aligned"}, 2.0)
    run = RunFile(path)
    assert run.complete
    assert run.attributes["strategy"] == "relax"
    assert run.result == {"status": "aligned"}
    assert len(run.table("ticks")) == 20


@started
async def test_the_run_of_a_killed_recorder_is_closed_and_the_next_is_whole(
    recorder: Recorder, failures: list[str], config: RigConfig, tmp_path: Path
) -> None:
    path = await recorder.begin(tmp_path, config, REQUEST)
    add_rows(recorder, 20)
    recorder._send_rows()
    await recorder._ask("sync")
    process(recorder).kill()
    await process(recorder).wait()
    await until_told(recorder, failures, 20)
    assert failures == ["the recorder ended before the run did"]
    await recorder.finish({"status": "fault"}, 1.0)
    run = RunFile(path)
    assert not run.complete
    assert run.result == {"status": "fault"}
    assert run.table("torque")["counter"].tolist() == list(range(20))
    assert [(event.kind, event.text) for event in run.events] == [("recorder", failures[0])]
    await assert_records(recorder, tmp_path, config)
    assert list(tmp_path.glob("*.journal")) == []
    assert len(failures) == 1


@started
async def test_a_stalled_recorder_is_killed_and_replaced(
    recorder: Recorder,
    failures: list[str],
    config: RigConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = await recorder.begin(tmp_path, config, REQUEST)
    add_rows(recorder, 20)
    recorder._send_rows()
    await recorder._ask("sync")
    stalled = process(recorder)
    stalled.send_signal(signal.SIGSTOP)
    monkeypatch.setattr(recorder_module, "_REPLY_TIMEOUT_S", 0.3)
    monkeypatch.setattr(recorder_module, "_CHECK_S", 0.1)
    await until_told(recorder, failures, 20)
    assert failures == ["the recorder did not answer within 0.3 s; look at the disk of the runs"]
    monkeypatch.undo()
    assert await stalled.wait() == -signal.SIGKILL
    await recorder.finish({"status": "fault"}, 1.0)
    assert RunFile(path).table("torque")["counter"].tolist()[:20] == list(range(20))
    assert list_runs(tmp_path)[0].status == "fault"
    await assert_records(recorder, tmp_path, config)


@started
async def test_a_late_answer_answers_no_other_question(
    recorder: Recorder, config: RigConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await recorder._ask("sync")
    stalled = process(recorder)
    stalled.send_signal(signal.SIGSTOP)
    monkeypatch.setattr(recorder_module, "_REPLY_TIMEOUT_S", 0.3)
    with pytest.raises(RigFault, match=r"did not answer within 0\.3 s"):
        await recorder.begin(tmp_path, config, REQUEST)
    monkeypatch.undo()
    stalled.send_signal(signal.SIGCONT)
    await assert_records(recorder, tmp_path, config)
    assert [run.strategy for run in list_runs(tmp_path)] == ["relax"]


@started
async def test_a_start_that_was_given_up_leaves_nothing(
    recorder: Recorder, config: RigConfig, tmp_path: Path
) -> None:
    begun = asyncio.create_task(recorder.begin(tmp_path, config, REQUEST))
    while not list(tmp_path.glob("*.journal")):
        await asyncio.sleep(0)
    begun.cancel()
    await asyncio.gather(begun, return_exceptions=True)
    await assert_records(recorder, tmp_path, config)
    assert [run.strategy for run in list_runs(tmp_path)] == ["relax"]


@started
async def test_a_run_stalled_at_its_end_is_closed_by_another_recorder(
    recorder: Recorder,
    failures: list[str],
    config: RigConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = await recorder.begin(tmp_path, config, REQUEST)
    add_rows(recorder, 20)
    recorder._send_rows()
    await recorder._ask("sync")
    process(recorder).send_signal(signal.SIGSTOP)
    ask = recorder._ask

    async def ask_once_briefly(*message: Any, work_bytes: int = 0) -> Any:
        monkeypatch.setattr(recorder_module, "_REPLY_TIMEOUT_S", 0.3 if message[0] == "finish" else 10.0)
        return await ask(*message, work_bytes=work_bytes)

    monkeypatch.setattr(recorder, "_ask", ask_once_briefly)
    with pytest.raises(RigFault, match=r"did not answer within .*; what it had written is in"):
        await recorder.finish({"status": "aligned"}, 2.0)
    run = RunFile(path)
    assert not run.complete
    assert run.table("torque")["counter"].tolist() == list(range(20))
    await assert_records(recorder, tmp_path, config)


@started
async def test_what_no_file_can_hold_is_refused_before_there_is_one(
    recorder: Recorder, failures: list[str], config: RigConfig, tmp_path: Path
) -> None:
    for what, value in (
        ("strategy", "a\0b"),
        ("strategy", "\ud800"),
        ("strategy", "s" * 100_000),
        ("parameters", "p\0"),
        ("options", {"not": "text"}),
        ("options", None),
    ):
        with pytest.raises(BadInput, match=f"^{what}: ") as told:
            await recorder.begin(tmp_path, config, {**REQUEST, what: value})
        assert len(str(told.value)) < 200
        assert list(tmp_path.iterdir()) == []
    for folder, named in (
        (Path("/proc/nowhere"), "/proc/nowhere"),
        (Path(__file__), f"{Path(__file__).name}: cannot be the folder of the runs: Not a directory"),
    ):
        with pytest.raises(BadInput, match=named):
            await recorder.begin(folder, config, REQUEST)
    await assert_records(recorder, tmp_path, config)
    assert failures == []


@started
async def test_an_answer_of_any_length_ends_the_recorder_and_not_the_daemon(
    recorder: Recorder,
    failures: list[str],
    config: RigConfig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mad = tmp_path / "mad"
    mad.write_text('#!/bin/sh\necho \'{"number": 0, "ready": true}\'\nhead -c 3000000 /dev/zero\nsleep 30\n')
    mad.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(mad))
    process(recorder).kill()
    await process(recorder).wait()
    await recorder._links[-1]._listening
    with pytest.raises(RigFault, match="the recorder answered what no recorder says"):
        await recorder.begin(tmp_path, config, REQUEST)
    monkeypatch.undo()
    mad.unlink()
    await assert_records(recorder, tmp_path, config)


@started
async def test_any_error_in_the_recorder_ends_one_run_alone(
    recorder: Recorder, failures: list[str], config: RigConfig, tmp_path: Path
) -> None:
    path = await recorder.begin(tmp_path, config, REQUEST)
    recorder.raw("no such table", (1.0, 2.0))
    await until_told(recorder, failures)
    assert failures == ["the run cannot be recorded: KeyError: 'no such table'"]
    await recorder.finish({"status": "fault"}, 0.0)
    assert RunFile(path).result == {"status": "fault"}
    assert not RunFile(path).complete
    await assert_records(recorder, tmp_path, config)


@started
async def test_a_disk_that_refuses_is_told_once(
    recorder: Recorder, failures: list[str], config: RigConfig, tmp_path: Path
) -> None:
    path = await recorder.begin(tmp_path, config, REQUEST)
    # a file that may not grow fails like a disk that is full
    size_bytes = journal_path(path).stat().st_size
    resource.prlimit(process(recorder).pid, resource.RLIMIT_FSIZE, (size_bytes, resource.RLIM_INFINITY))
    n = 0
    while not failures:
        add_rows(recorder, 1, n)
        n += 1
        await asyncio.sleep(0)
    with pytest.raises(RigFault, match="cannot be made: File too large; the run is kept in"):
        await recorder.finish({"status": "fault"}, n * 0.005)
    assert len(failures) == 1
    assert failures[0].startswith(f"the run cannot be recorded: {path}: the run cannot be written: File too")
    assert "\n" not in failures[0]
    run = RunFile(path)
    assert run.result == {"status": "fault"}
    assert (run.table("torque")["time_s"] >= 1.0).all()
    assert run.table("torque")["counter"].tolist() == list(range(len(run.table("torque"))))
    resource.prlimit(process(recorder).pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
    await assert_records(recorder, tmp_path, config)


@started
async def test_a_folder_that_was_taken_away_is_told(
    recorder: Recorder, failures: list[str], config: RigConfig, tmp_path: Path
) -> None:
    folder = tmp_path / "runs"
    path = await recorder.begin(folder, config, REQUEST)
    add_rows(recorder, 20)
    shutil.rmtree(folder)
    await until_told(recorder, failures, 20)
    assert f"{journal_path(path)}: was deleted or moved while the run was written to it" in failures[0]
    with pytest.raises(RigFault, match="was deleted or moved"):
        await recorder.finish({"status": "fault"}, 1.0)
    await assert_records(recorder, folder, config)


async def test_the_run_of_a_killed_daemon_is_told_and_closed_at_the_next_start(
    failures: list[str], config: RigConfig, tmp_path: Path
) -> None:
    path = killed_daemon(tmp_path)
    os.utime(journal_path(path), (2e9, 2e9))  # a clock that was wrong changes nothing
    assert [run.status for run in list_runs(tmp_path)] == ["cut off"]
    assert unfinished_runs(tmp_path) == [path]
    recorder = Recorder(failures.append)
    await recorder.start(tmp_path)
    assert recorder._closing_left is not None
    await recorder._closing_left
    (told,) = recorder.unfinished
    assert told["run"] == str(path)
    assert told["text"] == f"the daemon or its computer went before the run ended: {path}"
    run = RunFile(path)
    assert [event.text for event in run.events] == [
        "the daemon ended without closing the run",
        "the daemon or its computer went before the run ended",
    ]
    assert len(run.table("ticks")) == 1
    assert [run.status for run in list_runs(tmp_path)] == ["cut off"]
    assert unfinished_runs(tmp_path) == []
    await assert_records(recorder, tmp_path, config)
    await recorder.close()


def killed_daemon(folder: Path) -> Path:
    """The run that a daemon leaves when it is killed."""
    child = subprocess.Popen(
        [sys.executable, "-c", DYING.format(folder=str(folder))], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    recorder_pid, path = child.stdout.readline().split()
    gone = os.pidfd_open(int(recorder_pid))
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    assert select.select([gone], [], [], 20)[0], "the recorder outlived its daemon"
    os.close(gone)
    return Path(path)


DYING = """
import asyncio, pathlib
from needle_rig.config.loader import load_rig_config
from needle_rig.service.recorder.recorder import Recorder
from tests.unit.service.test_recorder import REQUEST, SAMPLE

async def main():
    recorder = Recorder(print)
    await recorder.start(pathlib.Path("{folder}"))
    path = await recorder.begin(pathlib.Path("{folder}"), load_rig_config(), REQUEST)
    recorder.sample(SAMPLE)
    recorder._send_rows()
    print(recorder._links[-1].process.pid, path, flush=True)
    await asyncio.sleep(60)

asyncio.run(main())
"""
