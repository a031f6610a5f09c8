"""The README keeps its word: commands exist, the example is the file that is tested, pictures are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from needle_rig.cli.main import run

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_ci_runs_the_test_command_of_the_readme() -> None:
    commands = [line for line in README.splitlines() if line.endswith("scripts/test")]
    assert commands[0].startswith("python3 -m venv .venv && ")
    assert "grep -m1 'scripts/test$' README.md" in (ROOT / ".ci/run").read_text(encoding="utf-8")


def test_the_example_effect_is_the_one_that_the_tests_run() -> None:
    example = (ROOT / "tests/data/effects/slit_membrane.py").read_text(encoding="utf-8")
    assert f"```python\n{example}```" in README


@pytest.mark.parametrize("name", sorted(set(re.findall(r"(?:`|\$ |bin/|run )needle-rig ([a-z]+)", README))))
def test_every_command_named_exists(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([name, "--help"]) == 0
    assert "Usage:" in capsys.readouterr().out


@pytest.mark.parametrize("path", sorted(set(re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README))))
def test_every_picture_is_there(path: str) -> None:
    assert (ROOT / path).read_bytes().startswith(b"\x89PNG")
