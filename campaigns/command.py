"""The modules of a package that can be run, by their names."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path

from campaigns import ROOT

DEFINES = {"campaigns": "\nCAMPAIGN = ", "benchmarks": "\ndef main("}


def runnable(package: str) -> dict[str, Path]:
    """Files that define CAMPAIGN, or `main` in benchmarks, by name, but for parts of benchmarks (*_kinds)."""
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        if not path.stem.endswith("_kinds") and DEFINES[package] in path.read_text(encoding="utf-8"):
            found[path.stem] = path
    return found


def by_name(package: str, words: list[str]) -> int:
    """Run the one that the first word names with the rest as its arguments; its exit code, or 2."""
    known = runnable(package)
    if not words or words[0] not in known:
        for name, path in known.items():
            title = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0]
            print(f"{name:18s} {title}")
        if words and words[0] not in ("-h", "--help"):
            print(f"there is no {words[0]!r}; the names stand above", file=sys.stderr)
        return 0 if words[:1] in (["-h"], ["--help"]) else 2
    name, *rest = words
    place = known[name].relative_to(ROOT).with_suffix("")
    module = importlib.import_module(".".join(place.parts))
    if package == "campaigns":
        from campaigns.run import run

        return run(name, module.CAMPAIGN, rest)
    sys.argv = [f"python -m {package} {name}", *rest]
    return int(module.main() or 0)
