"""The page's files are kept by a browser under a name with their hash, until one of them changes."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from needle_rig.web import static_files
from needle_rig.web.static_files import KEPT, STATIC, place
from tests.web.served import Served


def test_the_first_page_names_files_that_are_there_and_may_be_kept(served: Served) -> None:
    first = served.ask("GET", "/", {})
    assert first.headers["cache-control"] == "no-store"
    named = re.findall(r' (?:src|href)="([^"]+)"', first.text)
    assert len(named) >= 6
    for name in named:
        answer = served.ask("GET", f"/{name}", {})
        assert answer.status_code == 200, name
        assert answer.headers["cache-control"] == KEPT
        assert answer.headers["x-content-type-options"] == "nosniff"
    glossary = served.ask("GET", "/glossary.html", {})
    style = re.findall(r'rel="stylesheet" href="([^"]+)"', glossary.text)
    assert served.ask("GET", f"/{style[0]}", {}).status_code == 200


@pytest.mark.parametrize("path", ["/app.js", "/static-0123456789abcdef/app.js", f"{place()}/nothing.js"])
def test_under_another_name_there_is_no_file(served: Served, path: str) -> None:
    answer = served.ask("GET", path, {})
    assert answer.status_code == 404
    assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize("path", ["about", "runs", "jobs"])
def test_what_the_api_says_is_never_kept(served: Served, path: str) -> None:
    assert served.ask("GET", f"/api/{path}").headers["cache-control"] == "no-store"


@pytest.mark.parametrize("changed", ["vendor/preact.js", "style.css"])
def test_the_name_changes_with_any_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    other = tmp_path / "static"
    shutil.copytree(STATIC, other)
    monkeypatch.setattr(static_files, "STATIC", other)
    assert place.__wrapped__() == place()
    (other / changed).write_text("changed")
    assert place.__wrapped__() != place()


def test_each_part_of_the_glossary_is_a_link_away_and_its_table_is_one(served: Served) -> None:
    text = served.ask("GET", "/glossary.html", {}).text
    links = re.findall(r'<a href="#([^"]+)"', text)
    assert links == re.findall(r'<h2 id="([^"]+)"', text)
    assert len(links) > 3
    assert '<th scope="col">means</th>' in text
    assert "|---" not in text
