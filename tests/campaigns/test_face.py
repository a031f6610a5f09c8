"""What a newcomer types has a test each, and prints what the evidence shows."""

from __future__ import annotations

import re

import pytest

from campaigns import ROOT
from campaigns.workbench.face import LINES, MISTAKES, table

PAGE = ROOT / "docs/evidence/face.md"


def test_each_line_is_held_by_a_test_that_there_is() -> None:
    for test in {*(line.test for line in LINES), *(mistake[-1] for mistake in MISTAKES)}:
        file, name = test.split("::")
        assert re.search(rf"^def {name}\(", (ROOT / "tests" / file).read_text(encoding="utf-8"), re.M), test


def test_the_page_has_every_line_and_none_failed() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert ", exit code 0" in page
    assert all(f"`{line.typed}`" in page for line in LINES if line.typed)
    assert f"{len(LINES) + len(MISTAKES)} lines, 0 print something else" in page


@pytest.mark.long
def test_every_line_prints_what_is_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    text, wrong = table()
    assert not wrong, [row for row in text.splitlines() if "**not " in row]
