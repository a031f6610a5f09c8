"""The nodes' tests again on libraries that watch themselves: coverage of the guard, sanitizers."""

from __future__ import annotations

import gzip
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from needle_rig.firmware.build import HOST_LIBRARY, build
from needle_rig.firmware.sources import core_sources, firmware_folder

GUARD_TESTS = ("test_guard.py", "test_guard_safety.py", "test_guard_latch.py", "test_motion.py")
NODE_TESTS = (*GUARD_TESTS, "test_nodes.py", "test_codecs.py")
GCC = shutil.which("gcc")


def run_tests(library: Path, *tests: str, **environment: str) -> None:
    here = Path(__file__).parent
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-x",
            "-p",
            "no:cacheprovider",
            "-n0",
            "--hypothesis-profile=ci",
            *(here / name for name in tests),
        ],
        env={**os.environ, "NEEDLE_RIG_FIRMWARE": str(library), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


def gcc_library(out: Path, *flags: str) -> None:
    sources = map(str, core_sources(firmware_folder()))
    command = ["gcc", "-std=c11", "-g", "-fPIC", "-shared", *flags, *sources, "-o", HOST_LIBRARY]
    subprocess.run(command, cwd=out, check=True, capture_output=True)


@pytest.fixture(scope="module")
def covered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library that counts, after the guard's tests."""
    folder = tmp_path_factory.mktemp("covered")
    gcc_library(folder, "-O0", "--coverage")
    run_tests(folder, *GUARD_TESTS)
    return folder


@pytest.mark.whole
@pytest.mark.skipif(None in (GCC, shutil.which("gcov")), reason="needs gcc and gcov")
@pytest.mark.parametrize(("name", "least_lines", "least_branches"), [("guard", 120, 120), ("motion", 40, 30)])
def test_every_line_and_branch_of_the_guard_is_taken(
    covered: Path, name: str, least_lines: int, least_branches: int
) -> None:
    (data,) = covered.glob(f"*nr_{name}.gcda")
    subprocess.run(["gcov", "--json-format", "-b", data.name], cwd=covered, check=True, capture_output=True)
    (report,) = covered.glob(f"*nr_{name}*.gcov.json.gz")
    files = json.loads(gzip.decompress(report.read_bytes()))["files"]
    (source,) = (file for file in files if file["file"].endswith(f"nr_{name}.c"))
    lines = source["lines"]
    assert len(lines) > least_lines
    assert sum(len(line["branches"]) for line in lines) > least_branches
    missed = [line["line_number"] for line in lines if not line["count"]]
    one_way = [line["line_number"] for line in lines if not all(b["count"] for b in line["branches"])]
    assert missed == []
    assert one_way == []


def asan() -> Path | None:
    """gcc's address sanitizer, which has to be loaded before Python."""
    if GCC is None:
        return None
    said = subprocess.run(["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    path = Path(said.stdout.strip())
    return path.resolve() if path.is_absolute() else None


@pytest.mark.whole
def test_counts_that_jump_are_no_undefined_behaviour(tmp_path: Path) -> None:
    build(tmp_path, only_host=True, host_flags=("-fsanitize=undefined", "-fsanitize-trap=undefined"))
    run_tests(
        tmp_path,
        "test_nodes.py::test_counts_that_jump_with_one_count_a_turn_are_a_velocity_of_the_right_sign",
    )


@pytest.mark.slow
def test_no_undefined_behaviour_and_no_bad_address(tmp_path: Path) -> None:
    runtime = asan()
    if runtime is None:
        # The compiler of the extra `bench` watches for undefined behaviour alone.
        flags = ("-fsanitize=undefined", "-fsanitize-trap=undefined")
        build(tmp_path, only_host=True, host_flags=flags)
        run_tests(tmp_path, *NODE_TESTS)
        pytest.skip("no undefined behaviour; addresses were not watched: needs gcc with libasan")
    gcc_library(tmp_path, "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    # Python itself leaks at its end, by design.
    run_tests(tmp_path, *NODE_TESTS, LD_PRELOAD=str(runtime), ASAN_OPTIONS="detect_leaks=0")
