"""Whether a document is as the server's OpenAPI says."""

from __future__ import annotations

from typing import Any

from needle_rig.web.openapi import REFERENCE, openapi_document

PYTHON: dict[str, Any] = {
    "string": str,
    "number": (int, float),
    "integer": int,
    "boolean": bool,
    "null": type(None),
}


def _may_be(value: Any, found: dict[str, Any]) -> bool:
    kind = PYTHON.get(found.get("type", ""))
    return (kind is None and value is not None and "enum" not in found) or (
        value in found["enum"] if "enum" in found else kind is not None and isinstance(value, kind)
    )


def fits(value: Any, found: dict[str, Any], at: str, whole: bool = True) -> None:
    """Whether a value is as the schema says; of a `whole` one a key that it does not know is an error."""
    schemas = openapi_document()["components"]["schemas"]
    if "$ref" in found:
        return fits(value, schemas[found["$ref"].removeprefix(REFERENCE)], at, whole)
    if "anyOf" in found:
        kinds = [part for part in found["anyOf"] if _may_be(value, part)]
        assert kinds, at
        return fits(value, kinds[0], at, whole)
    if "enum" in found:
        assert value in found["enum"], at
    elif found.get("type") == "array":
        for k, one in enumerate(value):
            fits(one, found["items"], f"{at}[{k}]", whole)
    elif "properties" in found:
        assert set(found.get("required", ())) <= value.keys(), at
        assert not whole or value.keys() <= found["properties"].keys(), at
        for name in found["properties"].keys() & value.keys():
            fits(value[name], found["properties"][name], f"{at}.{name}", whole)
    elif "additionalProperties" in found:
        for name, one in value.items():
            fits(one, found["additionalProperties"], f"{at}.{name}", whole)
    elif found.get("type") in PYTHON:
        assert isinstance(value, PYTHON[found["type"]]), at
    return None
