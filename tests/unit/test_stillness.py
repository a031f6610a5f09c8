"""The witness sees a pause, and only a trial during which it saw one is repeated."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.stillness import Stillness

ROOT = Path(__file__).parents[2]
CONFTEST = """
import tests.conftest as rules
from tests.conftest import pytest_runtest_protocol, pytest_terminal_summary

class Told:
    pauses_s = {pauses_s}
    def longest_s(self):
        return self.pauses_s.pop(0)
    def close(self):
        pass

rules.Stillness = Told
"""
TEST = """
import pytest
trials = []

@pytest.mark.real_time
def test_works_the_third_time():
    trials.append(1)
    assert len(trials) == 3
"""


@pytest.mark.real_time
def test_a_pause_is_seen_once() -> None:
    witness = Stillness()
    try:
        witness.longest_s()
        watcher = witness._watchers[-1]
        watcher.send_signal(signal.SIGSTOP)
        select.select([], [], [], 0.06)
        watcher.send_signal(signal.SIGCONT)
        assert 0.05 < witness.longest_s() < 0.2
        assert witness.longest_s() < 0.05
    finally:
        witness.close()


@pytest.mark.parametrize(
    ("pauses_s", "ends", "workers"),
    [
        ([0.0, 0.06, 0.0, 0.06, 0.0, 0.0], "1 passed", "0"),
        ([0.0, 0.06, 0.0, 0.06, 0.0, 0.0], "1 passed", "1"),
        ([0.0, 0.06, 0.0, 0.009], "1 failed", "0"),
        ([0.0, 0.0], "1 failed", "0"),
    ],
)
def test_only_a_spoiled_trial_is_repeated(
    tmp_path: Path, pauses_s: list[float], ends: str, workers: str
) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST.format(pauses_s=pauses_s))
    (tmp_path / "test_it.py").write_text(TEST)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = real_time\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-n", workers, str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=60,
    )
    assert ends in done.stdout
    assert done.stdout.count("the machine paused for 60 ms") == pauses_s.count(0.06)
