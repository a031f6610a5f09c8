"""What nothing uses is deleted: vulture looks at the package; tests, campaigns and shipped effects use it."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
FOUND_BY_FILE_NAME = ("needle_rig/physics/effects", "needle_rig/control/strategies")
"""One class a file, looked up by the file's name; its fields are read by their names."""
CALLED_BY_LIBRARIES = {
    "__dir__": "Python: attributes of the package",
    "__getattr__": "Python: attributes of the package",
    "Ki": "simple_pid",
    "MAX_RETRIES": "canopen",
    "RESPONSE_TIMEOUT": "canopen",
    "_callbacks": "cffi: kept alive",
    "_finalize_final_module": "numba",
    "_finalized": "numba",
    "_one_of_both": "pydantic",
    "_optimize_final_module": "numba",
    "_options_end": "pydantic",
    "get_code": "importlib",
    "_repr_png_": "IPython",
    "compress_type": "zipfile",
    "define_pipelines": "numba",
    "disconnected": "uvicorn",
    "format_commands": "click",
    "get_source_stamp": "numba",
    "ignore_aliases": "PyYAML",
    "model_config": "pydantic",
    "no_compile": "numba",
    "padding": "intelhex",
    "reducer_override": "pickle",
    "send_message": "canopen",
    "typing_context": "numba",
    "yaml_implicit_resolvers": "PyYAML",
}
READ_BY_NAME = {
    "hall_mean_deg": "a quantity of published values",
    "hall_range_deg": "a quantity of published values",
    "made_ns": "a socket's identity, compared whole",
    "packaged_files": "Python within scripts/package-deb",
    "recover": "a request to the recorder",
    "written_by": "a file's head, which is read before its schema",
}


@pytest.mark.whole
def test_every_name_is_used_and_every_exception_is_needed() -> None:
    looked_at = pytest.importorskip("vulture").Vulture()
    effects = REPOSITORY / "config" / "recordings" / "effects"
    users = [REPOSITORY / name for name in ("needle_rig", "tests", "campaigns", "benchmarks", "scripts")]
    looked_at.scavenge([str(path) for path in (*users, effects)])
    unused = {}
    for item in looked_at.get_unused_code(min_confidence=60):
        place = Path(item.filename).resolve().relative_to(REPOSITORY)
        looked_up = str(place.parent) in FOUND_BY_FILE_NAME or item.first_lineno in keys_in(
            REPOSITORY / place
        )
        if place.parts[0] == "needle_rig" and not looked_up:
            unused[item.name] = f"{place}:{item.first_lineno}: {item.typ} {item.name}"
    exceptions = CALLED_BY_LIBRARIES.keys() | READ_BY_NAME.keys()
    assert [place for name, place in sorted(unused.items()) if name not in exceptions] == []
    assert sorted(exceptions - unused.keys()) == []


@cache
def keys_in(path: Path) -> frozenset[int]:
    """Lines of the keys of TypedDicts, which are read by name: mypy holds them."""
    typed, lines = {"TypedDict"}, set()
    for part in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(part, ast.ClassDef) and typed & {ast.unparse(base) for base in part.bases}:
            typed.add(part.name)
            lines |= {key.lineno for key in part.body if isinstance(key, ast.AnnAssign)}
    return frozenset(lines)
