"""The witness sees a pause, and only a trial during which it saw one is repeated."""

from __future__ import annotations

import itertools
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
import tests.trials as rules

pytest_plugins = ["tests.trials"]

class Told:
    pauses_s = {pauses_s}
    def __init__(self, wake_s, priority):
        pass
    def longest_s(self):
        return self.pauses_s.pop(0)
    def close(self):
        pass

rules.Stillness = Told
"""
TEST = """
import collections
import pytest
trials = collections.Counter()

@pytest.mark.real_time
@pytest.mark.parametrize("machine", ["spoils_two", "spoils_one", "keeps_time"])
def test_works_the_third_time(machine):
    trials[machine] += 1
    assert trials[machine] == 3
"""
PAUSES_S = (0.0, 0.06, 0.0, 0.06, 0.0, 0.0), (0.0, 0.06, 0.0, 0.009), (0.0, 0.0)


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


@pytest.mark.parametrize("workers", ["0", pytest.param("1", marks=pytest.mark.whole)])
def test_only_a_spoiled_trial_is_repeated(tmp_path: Path, workers: str) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST.format(pauses_s=list(itertools.chain(*PAUSES_S))))
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
    assert "2 failed, 1 passed" in done.stdout
    told = [line for line in done.stdout.splitlines() if line.endswith("the machine paused for 60 ms")]
    assert [line.partition("[")[2].partition("]")[0] for line in told] == ["spoils_two"] * 2 + ["spoils_one"]
