"""The whole command on ports that fail: the message names the link, the exit code is 3, the run is whole."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial

from needle_rig.config.loader import rig_config_text
from needle_rig.config.schema import RigConfig
from needle_rig.recording.reader import RunFile
from needle_rig.simulation.bench.process import Bench


@pytest.fixture
def rig_file(config: RigConfig, tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(rig_config_text(config))
    return path


@pytest.fixture
def compensate(rig_file: Path, tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []

    def start(*options: str) -> subprocess.Popen[str]:
        command = [
            sys.executable,
            "-m",
            "needle_rig",
            "compensate",
            "--target",
            "45",
            "--json",
            "--no-picture",
        ]
        process = subprocess.Popen(
            [*command, "--config", str(rig_file), "--out", str(tmp_path / "runs"), *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
        )
        started.append(process)
        return process

    yield start
    for process in started:
        with process:
            process.terminate()  # and with it its daemon, which holds the ports


def turning(bench: Bench) -> None:
    """Wait until the base of the bench turns."""
    deadline_s = time.monotonic() + 60
    while time.monotonic() < deadline_s:
        bench.tell("status")
        said = bench.wait_for(lambda said: "base_deg" in said, 10)
        if abs(said["velocity_deg_s"]) > 5:
            return
        select.select([], [], [], 0.05)
    raise TimeoutError("the base did not turn within 60 s")


@pytest.mark.parametrize("link", ["torque", "hall", "drive"])
def test_a_link_pulled_in_mid_run(
    bench: Bench, compensate: Callable[..., subprocess.Popen[str]], tmp_path: Path, link: str
) -> None:
    process = compensate()
    turning(bench)
    failed_s = bench.harm(link, "unplug")
    stopped = bench.wait_for(lambda said: said.get("event") == "command" and not said["enable"], 10)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 3, err
    assert "Traceback" not in err
    assert f"the {link} link is dead" in err or (link == "torque" and "the torque node went quiet" in err)
    result = json.loads(out)
    assert result["status"] == "fault"
    run = RunFile(result["run"])
    assert run.complete
    assert run.table("ticks")["time_s"][-1] > failed_s
    assert stopped["time_s"] - failed_s < 0.2


def refused(process: subprocess.Popen[str]) -> str:
    """The one sentence of a command that could not begin."""
    out, err = process.communicate(timeout=60)
    assert process.returncode in (2, 3)
    assert out == ""
    (sentence,) = err.strip().splitlines()
    return sentence


def test_a_port_that_is_taken_is_one_sentence(
    compensate: Callable[..., subprocess.Popen[str]], config: RigConfig
) -> None:
    # held by this test: another compensation would let go of it as soon as a pause of the machine ended it
    with serial.Serial(config.links.ports["hall.port"], exclusive=True):
        assert "in use by another program" in refused(compensate())


def test_a_port_that_is_missing_is_one_sentence(
    compensate: Callable[..., subprocess.Popen[str]], rig_file: Path, config: RigConfig
) -> None:
    rig_file.write_text(rig_config_text(config).replace(config.links.ports["hall.port"], "/dev/ttyNOTHERE"))
    assert "there is no /dev/ttyNOTHERE" in refused(compensate())
