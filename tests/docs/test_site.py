"""The documentation keeps its word: it builds, its links lead somewhere, nothing comes from elsewhere."""

from __future__ import annotations

import html
import json
import os
import re
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import click
import pytest

from needle_rig.cli.main import group

ROOT = Path(__file__).parents[2]
PAGES = sorted(path for path in (ROOT / "docs").rglob("*.md"))
TEXTS = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
CALL = re.compile(r"needle-rig ([a-z][a-z-]*)(?![\w/.])([^`\n|]*)")
CODE = re.compile(r"```[^\n]*\n(.*?)```|`([^`\n]+)`|^ {4}([^\n]+)$", re.DOTALL | re.MULTILINE)
PATH = re.compile(r"`((?:[a-z_]+/)+[\w.]+\.(?:py|c|h|md|yaml|dbc|service|jsonl))`")
LOADS = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src", "object": "data"}


class Seen(HTMLParser):
    """Links, loads, anchors and text of one page."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag in LOADS and LOADS[tag] in given:
            self.loads.append(given[LOADS[tag]])


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly: whatever MkDocs warns of ends the build.

    Some 12 s of a core, of whichever test asks first: all that ask are marked `whole`.
    """
    for package in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
        pytest.importorskip(package)
    folder = tmp_path_factory.mktemp("docs") / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="session")
def seen(site: Path) -> dict[Path, Seen]:
    return {page: Seen(page) for page in site.rglob("*.html")}


@pytest.mark.whole
def test_every_link_leads_somewhere(site: Path, seen: dict[Path, Seen]) -> None:
    dead = []
    for page, what in seen.items():
        if page.name == "404.html":
            continue  # its links start at the root of a server
        for link in [*what.links, *what.loads]:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target.is_dir() else target
            anchor = unquote(parts.fragment)
            if not target.is_file() or (anchor and target in seen and anchor not in seen[target].anchors):
                dead.append(f"{page.relative_to(site)}: {link}")
    assert not dead


@pytest.mark.whole
def test_every_page_is_in_the_menu(site: Path, seen: dict[Path, Seen]) -> None:
    start = site / "index.html"
    reached = {(start.parent / urlsplit(link).path).resolve() for link in seen[start].links}
    assert {page for page in seen if page.name != "404.html"} <= reached | {start.resolve()}


def other_hosts(name: str, text: str) -> list[str]:
    """What a browser would fetch from elsewhere for this file."""
    if name.endswith(".js"):
        return [u for u in re.findall(r"[\"'`](https?://[^\"'`]*)", text) if "www.w3.org" not in u]
    found = re.findall(r"@import\s+[\"']?((?:https?:)?//[^\"';)]+)", text)
    found += re.findall(r"url\(\s*[\"']?((?:https?:)?//[^\"')]+)", text)
    if name.endswith(".html"):
        found += re.findall(
            r"<(?!a\b)[a-z]+\s[^>]*?\b(?:src|href|data|srcset)=\"((?:https?:)?//[^\"]+)", text
        )
    return found


@pytest.mark.whole
def test_nothing_is_loaded_from_another_host(site: Path) -> None:
    files = [path for path in site.rglob("*") if path.suffix in {".html", ".css", ".js", ".svg"}]
    loads = {path.name: other_hosts(path.name, path.read_text(encoding="utf-8")) for path in files}
    assert not {name: urls for name, urls in loads.items() if urls}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.html", '<script async src="https://other.example/a.js"></script>'),
        ("a.html", '<link rel="stylesheet" href="//other.example/a.css">'),
        ("a.html", "<style>@import 'https://other.example/a.css';</style>"),
        ("a.css", "@font-face{src:url(https://other.example/a.woff2)}"),
        ("a.js", "fetch(`https://other.example/a`)"),
    ],
)
def test_a_load_from_another_host_would_be_noticed(name: str, text: str) -> None:
    assert len(other_hosts(name, text)) == 1
    assert not other_hosts(name, text.replace("https://other.example/", "").replace("//other.example/", ""))


@pytest.mark.whole
def test_formulas_are_drawn_without_a_script(site: Path) -> None:
    blocks = sum(page.read_text(encoding="utf-8").count("```math") for page in PAGES)
    drawn = [page.read_text(encoding="utf-8") for page in site.rglob("*.html")]
    assert sum(page.count("<math ") for page in drawn) >= blocks > 10
    left = [entry for page in drawn for entry in re.findall(r"<m[a-z]+[^>]*>\\[^<]*", page)]
    assert not left, "commands of LaTeX that are not known"


@pytest.mark.whole
def test_tables_from_the_code_are_there(site: Path) -> None:
    left = [page for page in site.rglob("*.html") if "<!-- generated" in page.read_text(encoding="utf-8")]
    assert not left
    expected = {
        "config": "motion_timeout_s",
        "effects": "Stribeck",
        "cli": "--require-aligned",
        "http": "lag_left_deg",
        "parameter-sets": "does not reproduce",
        "api": "needle_rig.workbench.selection.diagnose.diagnose",
    }
    for name, word in expected.items():
        page = html.unescape((site / "reference" / f"{name}.html").read_text(encoding="utf-8"))
        found = word.lower() in page.lower()
        assert found, f"{name}: {word}"


@pytest.mark.whole
def test_the_search_finds_a_word_of_the_glossary(site: Path) -> None:
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    assert "glossary.html" in {
        entry["location"].split("#")[0] for entry in index["docs"] if "Šidák" in entry["title"]
    }


def calls(page: Path) -> list[tuple[str, str]]:
    """Each command that a page shows, with the rest of its line."""
    code = "\n".join("".join(parts) for parts in CODE.findall(page.read_text(encoding="utf-8")))
    return CALL.findall(code.replace(" \\\n", " "))


def options_of(command: click.Command) -> set[str]:
    found = {option for parameter in command.params for option in parameter.opts + parameter.secondary_opts}
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner is not None
            found |= options_of(inner)
    return found | {"--help"}


MISTYPED = "diagnoze"
"""The command of which docs/evidence/face.md shows the answer."""


def test_commands_and_options_exist() -> None:
    context = click.Context(group)
    unknown = []
    for page in TEXTS:
        for name, rest in calls(page):
            command = group.get_command(context, name)
            given = set(re.findall(r"(?<!\S)(--[a-z][a-z-]*)", rest.split("#")[0]))
            if name == MISTYPED:
                continue
            if command is None or not given <= options_of(command):
                unknown.append(f"{page.relative_to(ROOT)}: needle-rig {name}{rest}")
    assert not unknown


def test_files_named_exist() -> None:
    made = {
        "config/effects/broken.py",
        "config/devices/NAME.py",
        "docs/evidence/NAME.md",
        "calibration/NODE.yaml",
    }
    places = (ROOT, ROOT / "needle_rig", ROOT / "needle_rig/workbench", ROOT / "docs")
    missing = []
    for page in TEXTS:
        text = page.read_text(encoding="utf-8")
        named = {*PATH.findall(text), *re.findall(r"scripts/[a-z_-]+(?:\.\w+)?", text)} - made
        absent = [name for name in named if not any((place / name).exists() for place in places)]
        missing += [f"{page.relative_to(ROOT)}: {name}" for name in absent]
    assert not missing


def test_every_picture_is_there() -> None:
    shown = [
        page.parent / picture
        for page in TEXTS
        for picture in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    ]
    assert shown
    assert not [path for path in shown if not path.is_file() or path.read_bytes()[:4] != b"\x89PNG"]


@pytest.mark.parametrize(
    ("page", "example"),
    [
        ("own-effect", "tests/data/effects/slit_membrane.py"),
        ("own-strategy", "needle_rig/control/strategies/single_lag.py"),
    ],
)
def test_an_example_is_the_file_that_the_tests_run(page: str, example: str) -> None:
    source = (ROOT / example).read_text(encoding="utf-8")
    assert f"```python\n{source}```" in (ROOT / "docs/how-to" / f"{page}.md").read_text(encoding="utf-8")


def test_the_rooms_are_those_of_the_contracts() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    rooms = {tuple(c["containers"]): c["layers"] for c in contracts if c["type"] == "layers"}
    page = (ROOT / "docs/explanation/architecture.md").read_text(encoding="utf-8")
    blocks = [re.split(r"\n", block.strip()) for block in re.findall(r"```\n(.*?)```", page, re.DOTALL)]
    assert rooms[("needle_rig",)] in blocks
    said = [[re.split(r" {2,}", line)[0] for line in block] for block in blocks]
    assert rooms[("needle_rig.workbench",)] in said
