"""The README keeps its word: short, its links lead somewhere, CI runs what it tells a newcomer to run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
MOST_LINES = 130
"""A door: what more there is to say has a page in docs."""


def test_it_is_short() -> None:
    assert len(README.splitlines()) <= MOST_LINES


def test_ci_runs_the_test_command_of_the_readme() -> None:
    (command,) = [line for line in README.splitlines() if line.endswith("pytest")]
    assert command.startswith("python3 -m venv .venv && ")
    assert command in (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("path", sorted(set(re.findall(r"\]\(([^)#:]+)\)", README))))
def test_every_link_leads_to_a_file(path: str) -> None:
    assert (ROOT / path).is_file()


def test_what_it_shows_of_the_circle_is_in_the_tutorial_that_is_run() -> None:
    tutorial = (ROOT / "docs/tutorial/circle.md").read_text(encoding="utf-8")
    shown = README.split("```console\n")[1].split("```")[0].splitlines()
    assert len(shown) > 8
    assert all(line == "…" or line in tutorial.splitlines() for line in shown)
