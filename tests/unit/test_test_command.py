"""scripts/test runs the default tests in two halves and all, then the browser's; its exit code is theirs."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts/test"
NOTHING_FOUND = 5
"""pytest's exit code when no test was selected."""
PYTHON = """#!/bin/sh
case "$*" in
    *"-m browser"*) exit 5 ;;
    *"not real_time"*) exit {together} ;;
    *real_time*) exit {alone} ;;
esac
exit 70
"""


def test_its_halves_are_the_default_run() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    words = shlex.split(settings["tool"]["pytest"]["ini_options"]["addopts"])
    script = SCRIPT.read_text(encoding="utf-8")
    assert f'quick="{words[words.index("-m") + 1]}"' in script
    assert re.findall(r'-m "\$quick and (not )?real_time"', script) == ["not ", ""]


@pytest.mark.parametrize(
    ("together", "alone", "code"),
    [
        (0, 0, 0),
        (0, NOTHING_FOUND, 0),
        (NOTHING_FOUND, 0, 0),
        (NOTHING_FOUND, NOTHING_FOUND, 1),
        (1, 0, 1),
        (0, 1, 1),
        (1, NOTHING_FOUND, 1),
        (NOTHING_FOUND, 1, 1),
    ],
)
def test_it_fails_when_a_half_fails_or_no_test_is_found(
    tmp_path: Path, together: int, alone: int, code: int
) -> None:
    programs = dict.fromkeys(("ruff", "mypy", "lint-imports", "mkdocs"), "#!/bin/sh\n")
    programs["python"] = PYTHON.format(together=together, alone=alone)
    for name, text in programs.items():
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run([SCRIPT], env={**os.environ, "PATH": path}, capture_output=True, text=True)
    assert done.returncode == code, done.stdout + done.stderr
    assert done.stderr.startswith("failed: ") == bool(code)
