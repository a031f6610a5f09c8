"""scripts/evidence writes a table below the head of its page, of a commit alone."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from campaigns import ROOT

HEAD = "# Stops\n\n**Question.** Do they hold?\n\n"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A repository with the script and one page."""
    if shutil.which("git") is None:
        pytest.skip("needs git")
    (tmp_path / "scripts").mkdir()
    (tmp_path / "docs/evidence").mkdir(parents=True)
    shutil.copy(ROOT / "scripts/evidence", tmp_path / "scripts/evidence")
    (tmp_path / "docs/evidence/stops.md").write_text(f"{HEAD}`old` at abc, exit code 0\n\nold\n")
    person = ("-c", "user.name=n", "-c", "user.email=e@example.org")
    for words in (("init", "-q"), ("add", "-A"), (*person, "commit", "-qm", "first")):
        subprocess.run(["git", "-C", tmp_path, *words], check=True)
    return tmp_path


def evidence(tree: Path, *command: str) -> subprocess.CompletedProcess[str]:
    line = [str(tree / "scripts/evidence"), "stops", *command]
    return subprocess.run(line, capture_output=True, text=True, check=False)


def test_the_head_of_a_page_stays_and_the_code_is_the_commands(tree: Path) -> None:
    done = evidence(tree, "sh", "-c", "echo 2000 stops; exit 1")
    assert done.returncode == 1, done.stderr
    text = (tree / "docs/evidence/stops.md").read_text()
    assert text.startswith(f"{HEAD}`sh -c echo 2000 stops; exit 1` at ")
    assert text.endswith(", exit code 1\n\n```\n2000 stops\n```\n")


def test_a_tree_with_changes_is_refused(tree: Path) -> None:
    with (tree / "scripts/evidence").open("a") as file:
        file.write("# changed\n")
    done = evidence(tree, "echo", "2000 stops")
    assert done.returncode == 2
    assert "commit first" in done.stderr
    assert "old" in (tree / "docs/evidence/stops.md").read_text()
