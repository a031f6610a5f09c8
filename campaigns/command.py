"""The modules of a package that can be run, by their names."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path

from campaigns import ROOT


def runnable(package: str) -> dict[str, Path]:
    """Files of `package` that define `main` or CAMPAIGN, by name, but for parts of benchmarks (*_kinds)."""
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if (
            not path.name.startswith("__")
            and not path.stem.endswith("_kinds")
            and ("\ndef main(" in text or "\nCAMPAIGN = " in text)
        ):
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
    sys.argv = [f"python -m {package} {name}", *rest]
    if hasattr(module, "CAMPAIGN"):
        from campaigns.run import run

        return run(name, module.CAMPAIGN, rest)
    return int(module.main() or 0)
