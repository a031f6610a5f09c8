"""A daemon that is stopped in mid-turn: the firmware stops the motor by itself and waits for a clear."""

from __future__ import annotations

import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from needle_rig.config.loader import load_rig_config, rig_config_text
from needle_rig.simulation.bench import process as bench_module
from needle_rig.simulation.bench.bench_lines import Said
from needle_rig.simulation.bench.process import Bench

NEEDLE_RIG = [sys.executable, "-m", "needle_rig"]
STOP_S = 0.06
TIMES = 3


def wait_s(seconds: float) -> None:
    select.select([], [], [], seconds)


def status(bench: Bench) -> Said:
    bench.tell("status")
    return bench.wait_for(lambda said: "base_deg" in said, 10)


@pytest.fixture
def firmware_bench() -> Iterator[Bench]:
    bench = bench_module.start(load_rig_config(None, {"simulation.nodes": "firmware"}))
    yield bench
    bench.close()


def test_the_drive_stops_while_the_daemon_is_stopped(firmware_bench: Bench, tmp_path: Path) -> None:
    bench = firmware_bench
    socket, rig_file = tmp_path / "daemon.sock", tmp_path / "rig.yaml"
    config = bench.configured(load_rig_config(None, {"sequence.settle_s": 0.5}))
    rig_file.write_text(rig_config_text(config))
    words = ["daemon", "--config", str(rig_file), "--socket", str(socket), "--out", str(tmp_path / "runs")]
    with subprocess.Popen([*NEEDLE_RIG, *words], stderr=subprocess.DEVNULL) as daemon:
        try:
            bench.wait_for(lambda said: said.get("event") == "command", 60)
            while not socket.exists():
                wait_s(0.05)
            for turn in range(TIMES):
                target = 60 + 70 * turn
                order = ["compensate", "--target", str(target), "--socket", str(socket), "--no-picture"]
                with subprocess.Popen(
                    [*NEEDLE_RIG, *order], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                ) as client:
                    while abs(status(bench)["velocity_deg_s"]) < 10:
                        assert client.poll() is None
                        wait_s(0.02)
                    daemon.send_signal(signal.SIGSTOP)
                    stopped_s = time.monotonic()
                    said = bench.wait_for(lambda said: said.get("event") == "drive", 2)
                    assert said["state"] == "fault"
                    assert said["time_s"] - said["late_s"] - stopped_s < STOP_S
                    rest = status(bench)
                    assert rest["velocity_deg_s"] == 0
                    wait_s(0.5)
                    daemon.send_signal(signal.SIGCONT)
                    assert client.wait(30) == 3
                wait_s(0.3)
                # The daemon may ask the drive to clear what has passed; nothing moves by that.
                held = status(bench)
                assert held["drive"] in ("fault", "ready")
                assert held["velocity_deg_s"] == 0
                assert held["base_deg"] == pytest.approx(rest["base_deg"], abs=1.0)
                cleared = subprocess.run(
                    [*NEEDLE_RIG, "clear", "--socket", str(socket)], capture_output=True, check=False
                )
                assert cleared.returncode == 0, cleared.stderr
        finally:
            daemon.send_signal(signal.SIGCONT)
            daemon.terminate()
