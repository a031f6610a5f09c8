"""A test that takes more than its share of the plain run is named, in whichever process it ran."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CONFTEST = """
import tests.conftest as rules
from tests.conftest import pytest_runtest_makereport, pytest_runtest_setup, pytest_terminal_summary

rules.NOTICED_S = 0.3
"""
TEST = """
import subprocess, sys, time
import pytest

WORK = "import time\\nwhile time.process_time() < 0.5: pass"

def test_works_here():
    until_s = time.process_time() + 0.5
    while time.process_time() < until_s: pass

def test_works_in_a_child():
    subprocess.run([sys.executable, "-c", WORK], check=True)

@pytest.mark.whole
def test_is_marked():
    subprocess.run([sys.executable, "-c", WORK], check=True)

def test_waits():
    time.sleep(0.5)
"""


@pytest.mark.whole
@pytest.mark.parametrize("workers", ["0", "1"])
def test_what_takes_long_without_a_mark_is_named(tmp_path: Path, workers: str) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_it.py").write_text(TEST)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = whole\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-n", workers, str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=60,
    )
    assert "4 passed" in done.stdout
    told = re.findall(r"::(\w+): \d\.\d s$", done.stdout.partition("mark them whole")[2], re.MULTILINE)
    assert told == ["test_works_here", "test_works_in_a_child"]
