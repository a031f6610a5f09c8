"""What a job may take: memory and processor time; what it says of files that want more."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from needle_rig.web import bounds

WORKER = """
import sys
from needle_rig.web import bounds, worker
bounds.READING_CPU_S = {cpu_s}
bounds.memory_bytes = lambda: {memory}
worker.main()
"""


def asked(folder: Path, cpu_s: int = 60, memory: int = 1 << 40) -> tuple[int, dict[str, Any], list[str]]:
    """Exit code, the last word and the complaints of a worker that guesses what is what in a folder."""
    files = sorted(path.name for path in folder.iterdir())
    request = {
        "kind": "guess",
        "folder": str(folder),
        "files": files,
        "layout": None,
        "machine": None,
        "name": "x",
        "out": "",
        "jobs": 1,
    }
    with subprocess.Popen(
        [sys.executable, "-c", WORKER.format(cpu_s=cpu_s, memory=memory)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        assert process.stdout is not None
        assert process.stderr is not None
        said = [json.loads(line) for line in process.stdout]
        return process.wait(), said[-1] if said else {}, process.stderr.read().splitlines()


def claim_every_cell(path: Path) -> None:
    """Write a spreadsheet with two numbers, one in its first cell and one in the last that there can be."""
    openpyxl = pytest.importorskip("openpyxl")
    pytest.importorskip("python_calamine")
    book = openpyxl.Workbook()
    book.active.cell(1, 1, 1.0)
    book.active.cell(1_048_576, 16_384, 1.0)
    book.save(path)


@pytest.mark.whole
def test_a_file_that_unpacks_to_more_than_a_jobs_memory_is_a_sentence(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "bomb.npz", a=np.zeros(150_000_000, np.uint8), b=np.zeros(150_000_000))
    _, said, _ = asked(tmp_path, memory=600 << 20)
    assert "GB of memory; give less data" in said["error"] or "Unable to allocate" in said["error"]


@pytest.mark.whole
def test_a_job_that_only_reads_ends_at_its_processor_time(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "long.csv", np.ones((400_000, 6)), delimiter=",")
    begun_s = time.monotonic()
    code, said, complaints = asked(tmp_path, cpu_s=1)
    assert "error" not in said
    assert time.monotonic() - begun_s < 60.0
    assert "s of processor time; give less data" in bounds.told(code, complaints)


@pytest.mark.whole
def test_a_spreadsheet_that_claims_every_cell_is_a_sentence(tmp_path: Path) -> None:
    claim_every_cell(tmp_path / "far.xlsx")
    code, said, complaints = asked(tmp_path)
    assert "error" not in said
    assert "GB of memory; give less data" in bounds.told(code, complaints)


def test_what_is_said_of_a_worker_that_ended_by_itself() -> None:
    assert bounds.told(-6, ["memory allocation of 9 bytes failed"]).startswith("this takes more than")
    assert bounds.told(1, ["a", "b"]) == "the work ended by itself: b"
    assert bounds.told(1, []) == "the work ended by itself: it said nothing"
