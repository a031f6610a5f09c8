import asyncio
import os
import resource
import select
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput, RigFault
from needle_rig.recording import RunFile
from needle_rig.records import DriveFault, DriveState, Phase, Sample
from needle_rig.service.recorder import Recorder

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
    await recorder.start()
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
    await recorder.start()
    path = await recorder.begin(tmp_path, config, REQUEST)
    await recorder.discard()
    assert not path.exists()
    await recorder.begin(tmp_path, config, REQUEST)
    await recorder.finish({}, 0.0)
    await recorder.close()
    assert len(list(tmp_path.iterdir())) == 1


async def test_a_folder_that_cannot_be_written_is_bad_input(config: RigConfig) -> None:
    recorder = Recorder(lambda sentence: None)
    await recorder.start()
    with pytest.raises(BadInput, match="/proc/nowhere"):
        await recorder.begin(Path("/proc/nowhere"), config, REQUEST)
    await recorder.close()


async def test_a_killed_recorder_is_told_at_once(config: RigConfig, tmp_path: Path) -> None:
    failures: list[str] = []
    recorder = Recorder(failures.append)
    await recorder.start()
    path = await recorder.begin(tmp_path, config, REQUEST)
    assert recorder._process is not None
    recorder._process.kill()
    await recorder._process.wait()
    assert recorder._listening is not None
    await recorder._listening
    assert failures == ["the recorder ended before the run did"]
    await recorder.finish({}, 0.0)  # no run is open any more: nothing to wait for
    with pytest.raises(RigFault, match="the recorder has ended"):
        await recorder.begin(tmp_path, config, REQUEST)
    await recorder.close()
    assert not RunFile(path).complete


async def test_a_disk_that_refuses_is_told_once(config: RigConfig, tmp_path: Path) -> None:
    failures: list[str] = []
    recorder = Recorder(failures.append)
    await recorder.start()
    path = await recorder.begin(tmp_path, config, REQUEST)
    assert recorder._process is not None
    # a file that may not grow fails like a disk that is full
    resource.prlimit(recorder._process.pid, resource.RLIMIT_FSIZE, (path.stat().st_size,) * 2)
    n = 0
    while not failures:
        recorder.raw("torque", (n * 0.005, n * 0.005, n, 1e-4))
        recorder.sample(replace(SAMPLE, time_s=n * 0.005))
        n += 1
        await asyncio.sleep(0)
    await recorder.finish({}, 0.0)
    await recorder.close()
    assert len(failures) == 1
    assert failures[0].startswith("the run cannot be recorded: ")
    assert str(path) in failures[0]


def test_a_daemon_that_dies_leaves_a_whole_file(tmp_path: Path) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", DYING.format(folder=str(tmp_path))], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    recorder_pid = int(child.stdout.readline())
    gone = os.pidfd_open(recorder_pid)
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    assert select.select([gone], [], [], 20)[0], "the recorder outlived its daemon"
    os.close(gone)
    (path,) = tmp_path.glob("*.h5")
    run = RunFile(path)
    assert run.complete
    assert [(event.kind, event.text) for event in run.events][-2:] == [
        ("recorder", "the daemon ended without closing the run"),
        ("end", ""),
    ]
    assert len(run.table("ticks")) == 1


DYING = """
import asyncio, pathlib
from needle_rig.config.loader import load_rig_config
from needle_rig.service.recorder import Recorder
from tests.unit.service.test_recorder import REQUEST, SAMPLE

async def main():
    recorder = Recorder(print)
    await recorder.start()
    await recorder.begin(pathlib.Path("{folder}"), load_rig_config(), REQUEST)
    recorder.sample(SAMPLE)
    recorder._send_rows()
    print(recorder._process.pid, flush=True)
    await asyncio.sleep(60)

asyncio.run(main())
"""
