"""The tutorial's walk round the circle, command by command, gives what the tutorial shows."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from needle_rig.cli.main import run

PAGE = Path(__file__).parents[3] / "docs/tutorial/circle.md"
MARK = "<!-- these commands and their output are run by tests/workbench/learning/test_tutorial.py -->"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
DATE = re.compile(r"\d{4}-\d{2}-\d{2}")


def walk() -> list[tuple[str, list[str]]]:
    """Each command of the tutorial with the lines that it prints; "…" stands for lines left out."""
    part = PAGE.read_text(encoding="utf-8").split(MARK)[1].split("\n## ")[0]
    steps: list[tuple[str, list[str]]] = []
    for block in re.findall(r"```console\n(.*?)```", part, re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ needle-rig "):
                steps.append((line.removeprefix("$ needle-rig "), []))
            else:
                steps[-1][1].append(line)
    return steps


def words(line: str) -> str:
    return " ".join(NUMBER.sub("#", DATE.sub("DATE", line)).split())


def last_place(number: str) -> float:
    digits, _, power = number.partition("e")
    return 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))


def same(shown: str, printed: str) -> bool:
    """The same words, and numbers within 3 % or one in their last place: processors round differently."""
    if words(shown) != words(printed):
        return False
    pairs = zip(*(NUMBER.findall(DATE.sub("", line)) for line in (shown, printed)), strict=True)
    return all(abs(float(a) - float(b)) <= max(0.03 * abs(float(a)), 1.01 * last_place(a)) for a, b in pairs)


@pytest.mark.slow
def test_every_command_prints_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    steps = walk()
    assert len(steps) == 7
    for command, shown in steps:
        assert run(shlex.split(command)) == 0
        printed = iter(capsys.readouterr().out.splitlines())
        for line in shown:
            if line != "…":
                assert any(same(line, candidate) for candidate in printed), f"{command}: {line}"
    for picture in ("pictures/residuals.png", "ladder.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("change", ["0.3503 to 0.3703", "present to absent"])
def test_a_changed_line_would_be_noticed(change: str) -> None:
    line = "present: stiffness = 0.3503 (95 %)"
    assert same(line, line)
    old, new = change.split(" to ")
    assert not same(line, line.replace(old, new))
