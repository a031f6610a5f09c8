"""Each room says what lives in it and what it may import, and the pages of the flow name what there is."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
CONTRACTS: list[dict[str, Any]] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "tool"
]["importlinter"]["contracts"]
LAYERS = [
    (contract["containers"][0], [layer.split(" | ") for layer in contract["layers"]])
    for contract in CONTRACTS
    if contract["type"] == "layers"
]
ROOMS = {
    f"{top}.{room}": [each for below in layers[place + 1 :] for each in below]
    for top, layers in LAYERS
    for place, layer in enumerate(layers)
    for room in layer
    if (ROOT / top.replace(".", "/") / room).is_dir()
}
"""Of each room the rooms below it."""
MOST_LINES = 18
STEPS = 10
PATH = re.compile(r"`([\w/.-]+(?:/|\.(?:py|md|json|yaml|dbc)))`")
FLOWS = [
    path for path in sorted((ROOT / "docs/explanation").glob("*.md")) if "| step | file |" in path.read_text()
]


def may_import(room: str) -> str:
    """The line of a room's README that the contracts give."""
    forbidden = {
        module
        for contract in CONTRACTS
        if contract["type"] == "forbidden" and room in contract["source_modules"]
        for module in contract["forbidden_modules"]
    }
    guarded = {
        module
        for contract in CONTRACTS
        if contract["type"] == "protected"
        and any(f"{allowed}.".startswith(f"{room}.") for allowed in contract["allowed_importers"])
        for module in contract["protected_modules"]
    }
    parts = [", ".join(f"`{each}`" for each in ROOMS[room] if f"needle_rig.{each}" not in forbidden)]
    _, house, *rest = room.split(".")
    if rest:
        parts.append(f"{'and ' if parts[0] else ''}what `{house}` may")
    outside = sorted(module for module in forbidden if "needle_rig" not in module)
    if outside:
        parts.append(f"not {', '.join(f'`{module}`' for module in outside)}")
    if guarded:
        parts.append(f"with few others {', '.join(f'`{module}`' for module in sorted(guarded))}")
    return f"May import: {'; '.join(filter(None, parts))}."


def test_every_room_says_what_it_may_import() -> None:
    assert len(ROOMS) > 20
    for room in ROOMS:
        text = (ROOT / room.replace(".", "/") / "README.md").read_text(encoding="utf-8")
        (line,) = [line for line in text.splitlines() if line.startswith("May import")]
        assert line == may_import(room), room


def test_every_room_names_files_that_there_are() -> None:
    missing = []
    for room in ROOMS:
        folder = ROOT / room.replace(".", "/")
        text = (folder / "README.md").read_text(encoding="utf-8")
        assert len(text.splitlines()) <= MOST_LINES, room
        missing += [
            f"{room}: {p}" for p in PATH.findall(text) if not any((x / p).exists() for x in (folder, ROOT))
        ]
    assert not missing


def defined(path: Path) -> set[str]:
    """Functions and methods of a file, with the class in front."""
    if path.suffix != ".py":
        return set(re.findall(r"^\w[^\n;]*?\b(\w+)\(", path.read_text(encoding="utf-8"), re.MULTILINE))
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{each.name}" for each in node.body if isinstance(each, FUNCTION)}
        elif isinstance(node, FUNCTION):
            found.add(node.name)
    return found


FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)


@pytest.mark.parametrize("page", FLOWS, ids=lambda page: page.stem)
def test_ten_steps_name_functions_that_there_are(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    steps = re.findall(r"^\| (\d+) \| `([^`]+)` \| `([^`]+)` \|", text, re.MULTILINE)
    assert [int(number) for number, _, _ in steps] == [*range(1, STEPS + 1)]
    prose = re.findall(r"`([\w.]+)`(?: of | in |\s\()`([\w/]+\.(?:py|c))`", text.replace("\n", " "))
    for path, name in [(path, name) for _, path, name in steps] + [(path, name) for name, path in prose]:
        place = ROOT / path if path.startswith("firmware/") else ROOT / "needle_rig" / path
        assert name in defined(place), (path, name)


def test_a_tick_a_diagnosis_and_a_stop_have_a_page() -> None:
    assert {page.stem for page in FLOWS} >= {"tick", "diagnosis-steps", "stop"}
