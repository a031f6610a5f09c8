#!/usr/bin/env python3
"""Write the browser's types of what the page's server answers, from its OpenAPI document.

scripts/web_types.py         writes needle_rig/web/static/types.d.ts
"""

from __future__ import annotations

import json
from typing import Any

from needle_rig.web.openapi import REFERENCE, openapi_document
from needle_rig.web.results import RESULTS
from needle_rig.web.static_files import STATIC

TYPES = STATIC / "types.d.ts"
HEAD = "// Made by scripts/web_types.py from the server's OpenAPI document; do not edit.\n"
PLAIN = {"string": "string", "integer": "number", "number": "number", "boolean": "boolean", "null": "null"}


def types() -> str:
    """The text of the file."""
    schemas = openapi_document()["components"]["schemas"]
    named = "; ".join(f"{kind.__name__}: {kind.__name__}" for kind in RESULTS)
    results = f"export type Results = {{ {named} }};\n"
    return (
        HEAD + results + "".join(f"export type {name} = {typed(found)};\n" for name, found in schemas.items())
    )


def typed(found: dict[str, Any]) -> str:
    """A JSON Schema as TypeScript; what has none is unknown."""
    if "$ref" in found:
        return str(found["$ref"].removeprefix(REFERENCE))
    if "const" in found:
        return json.dumps(found["const"], ensure_ascii=False)
    if "enum" in found:
        return " | ".join(json.dumps(value, ensure_ascii=False) for value in found["enum"])
    if "anyOf" in found:
        return " | ".join(dict.fromkeys(typed(part) for part in found["anyOf"]))
    kind = found.get("type")
    if kind == "array" and "prefixItems" in found:
        return f"[{', '.join(typed(part) for part in found['prefixItems'])}]"
    if kind == "array":
        inside = typed(found.get("items", {}))
        return f"({inside})[]" if " | " in inside else f"{inside}[]"
    if kind == "object" and "properties" in found:
        required = set(found.get("required", ()))
        parts = (
            f"{name}{'' if name in required else '?'}: {typed(part)}"
            for name, part in found["properties"].items()
        )
        return f"{{ {'; '.join(parts)} }}"
    if kind == "object":
        further = found.get("additionalProperties", {})
        return f"Record<string, {typed(further) if isinstance(further, dict) else 'unknown'}>"
    return PLAIN.get(str(kind), "unknown")


if __name__ == "__main__":
    TYPES.write_text(types(), encoding="utf-8")
    print(f"wrote {TYPES.name}")
