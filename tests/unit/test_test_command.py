"""scripts/test runs all tests but the longest, and the checks beside them; its exit code is theirs."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import pytest

from tests.conftest import APART

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts/test"
NOTHING_FOUND = 5
"""pytest's exit code when no test was selected."""
PYTHON = """case "$*" in
    *"-m browser"*) exit 5 ;;
    *"not real_time"*) exit {together} ;;
    *real_time*) exit {alone} ;;
esac
exit 70
"""


def test_it_runs_what_plain_pytest_runs_and_what_is_whole_or_in_real_time() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    words = shlex.split(settings["tool"]["pytest"]["ini_options"]["addopts"])
    plain = words[words.index("-m") + 1]
    assert plain == " and ".join(f"not {mark}" for mark in APART)
    script = SCRIPT.read_text(encoding="utf-8")
    everything = re.findall(r'^everything="(.*)"$', script, re.MULTILINE)
    assert [f"not whole and not real_time and {rest}" for rest in everything] == [plain]
    assert re.findall(r'-m "\$everything and (not )?real_time"', script) == ["not ", ""]


def told(folder: Path, programs: dict[str, str]) -> tuple[int, list[str]]:
    """Exit code of scripts/test with these programs in the place of the checks, and what it says failed."""
    for name, text in {**dict.fromkeys(("ruff", "mypy", "lint-imports", "mkdocs"), ""), **programs}.items():
        (folder / name).write_text(f"#!/bin/sh\n{text}\n")
        (folder / name).chmod(0o755)
    path = f"{folder}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run([SCRIPT], env={**os.environ, "PATH": path}, capture_output=True, text=True)
    return done.returncode, re.findall(r"^failed: (\S+)", done.stderr, re.MULTILINE)


@pytest.mark.parametrize(
    ("together", "alone", "failed"),
    [
        (0, 0, []),
        (0, NOTHING_FOUND, []),
        (NOTHING_FOUND, 0, []),
        (NOTHING_FOUND, NOTHING_FOUND, ["no"]),
        (1, 0, ["pytest"]),
        (0, 1, ["pytest"]),
        (1, NOTHING_FOUND, ["pytest"]),
        (NOTHING_FOUND, 1, ["pytest"]),
    ],
)
def test_it_fails_when_a_half_fails_or_no_test_is_found(
    tmp_path: Path, together: int, alone: int, failed: list[str]
) -> None:
    python = PYTHON.format(together=together, alone=alone)
    assert told(tmp_path, {"python": python}) == (bool(failed), failed)


def test_a_check_that_fails_beside_the_tests_is_told(tmp_path: Path) -> None:
    slow = "sleep 0.3; exit 2"  # it ends after the tests
    assert told(tmp_path, {"python": "", "mypy": slow, "mkdocs": slow}) == (1, ["mypy", "mkdocs"])
