"""A sample of `fuzz_files`: damaged files and requests of every kind end commands in order."""

from __future__ import annotations

import json
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import pytest

from campaigns import ROOT
from campaigns.files import fuzz_files

SAMPLE = """
import json, os, pathlib, sys
from argparse import Namespace
from campaigns.files import fuzz_files
work = pathlib.Path(sys.argv[1])
os.chdir(work)
sys.path[0] = str(fuzz_files.ROOT)
seeds = fuzz_files.made_seeds(work)
tasks = fuzz_files.plan(Namespace(size=1, first_seed=7))
print(json.dumps([task | fuzz_files.fuzzed(task, seeds, work, work / "bad") for task in tasks]))
"""


@pytest.mark.whole
def test_a_sample_of_damaged_files_ends_commands_in_order(tmp_path: Path) -> None:
    line = [sys.executable, "-c", SAMPLE, str(tmp_path)]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = json.loads(done.stdout)
    assert not fuzz_files.failed(rows), [row["bad"] for row in rows]
    lines = fuzz_files.table(rows, Namespace()).splitlines()
    assert len(lines) == len(rows) + 2 == 16
    assert sum(row["mutations"] for row in rows) >= 30
    refused, read = (sum(row["codes"].get(code, 0) for row in rows) for code in "20")
    assert refused > 10, "the damage is noticed"
    assert read > 10, "and files that are still whole are read"


def test_the_campaign_notices_what_it_looks_for(tmp_path: Path) -> None:
    source = (
        "import os, pathlib, sys, time; from campaigns.files import fuzz_files\n"
        "isolated, out = fuzz_files.isolated, pathlib.Path(sys.argv[1])\n"
        "fuzz_files.LONGEST_S = 0.5\n"
        "actions = [lambda: 2, lambda: 70, lambda: 1 / 0, lambda: time.sleep(60),"
        " lambda: os.kill(os.getpid(), 11), lambda: len(bytearray(5 << 30)) and 0]\n"
        "print([(isolated(a, out).code, isolated(a, out).bad) for a in actions])\n"
    )
    line = [sys.executable, "-c", source, str(tmp_path / "out")]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
    ends = "(2, False), (70, True), (99, True), (-9, True), (-11, True), (99, True)"
    assert done.stdout.strip() == f"[{ends}]", done.stderr
