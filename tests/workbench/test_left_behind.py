"""What a command leaves that is killed at a random instant while others work for it: no process."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.closed_loop.shell import ROOT, Shell, all_gone

SERIES = str(ROOT / "tests" / "data" / "practice" / "elastic")
COMMANDS = {
    "diagnose": ("diagnose", SERIES, "--jobs", "2"),
    "learn": ("learn", SERIES, "--jobs", "2"),
    "strategies": ("strategies", "--jobs", "2", "--seeds", "20"),
    "web": ("web", SERIES, "--jobs", "2"),
}
WORKERS = 2
STARTED_S = 60.0
LATEST_S = 3.0
"""After the second worker was seen: it still imports, computes or waits."""


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    with tempfile.TemporaryDirectory(prefix="nr-") as temporary:
        shell = Shell(tmp_path, temporary=temporary)
        yield shell
        end_all(shell)


def end_all(shell: Shell) -> None:
    for pid in shell.processes():
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.whole
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("name", COMMANDS)
def test_workers_end_with_the_command_that_started_them(name: str, number: int, shell: Shell) -> None:
    instant_s = random.Random(f"{name} {number}").uniform(0.0, LATEST_S)
    with shell.start(*COMMANDS[name]) as process:
        if name == "web":
            begin_job(process)
        wait_for_workers(shell, process)
        time.sleep(instant_s)
        process.send_signal(number)
        process.wait(20.0)
        try:
            all_gone(shell.processes(), within_s=10.0)
        finally:
            end_all(shell)  # they would hold the pipes that are read to their end now


def wait_for_workers(shell: Shell, process: subprocess.Popen[str]) -> None:
    deadline_s = time.monotonic() + STARTED_S
    while sum("spawn_main" in line for line in shell.processes().values()) < WORKERS:
        assert process.poll() is None
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def begin_job(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    address, _, token = process.stdout.readline().split()[-1].partition("/#token=")
    said = httpx.post(
        f"{address}/api/jobs",
        headers={"authorization": f"Bearer {token}"},
        json={"kind": "diagnose", "data": ["data:elastic"], "model": None},
        timeout=60.0,
    )
    assert said.is_success, said.text
