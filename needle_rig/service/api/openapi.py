"""The API's paths, and its OpenAPI document, made from the models of the orders."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from pydantic.json_schema import models_json_schema

from needle_rig.records import JsonObject
from needle_rig.service.api.orders import MODELS, Nothing
from needle_rig.version import VERSION

_REFERENCE = "#/components/schemas/{model}"


@dataclass(frozen=True)
class Path:
    """One method of one path, and the order that it stands for."""

    method: str
    path: str
    order: str
    summary: str
    status: int
    leased: bool = False


ROUTES = (
    Path("GET", "/state", "state", "What the daemon says of itself, the rig and the run.", 200),
    Path("POST", "/stop", "stop", "Stop the drive in the next tick; needs no lease.", 202),
    Path("POST", "/lease", "take_lease", "Take the lease, or renew the one in the header.", 201, True),
    Path("DELETE", "/lease", "return_lease", "Return the lease in the header.", 200, True),
    Path("POST", "/compensate", "compensate", "Start a sequence that aligns the needle.", 202, True),
    Path("POST", "/jog", "jog", "Turn the base by an angle or to one.", 202, True),
    Path("POST", "/home", "home", "Find the base's zero, or turn to it.", 202, True),
    Path("POST", "/hold", "hold", "Hold the base where it is, against what turns it.", 202, True),
    Path("POST", "/release", "release", "Let go of the base.", 202, True),
    Path("POST", "/clear", "clear", "Leave a fault.", 202, True),
)
_REFUSALS = {
    400: "It is no HTTP.",
    409: "A fault, a stop or another holder of the lease forbids it.",
    413: "It is too long.",
    422: "A value that cannot be used.",
    429: "Too many requests.",
}


@cache
def openapi_document() -> JsonObject:
    """The API as OpenAPI 3.1."""
    _, schemas = models_json_schema(
        [(model, "validation") for model in MODELS.values()], ref_template=_REFERENCE
    )
    paths: dict[str, JsonObject] = {}
    for route in ROUTES:
        paths.setdefault(route.path, {})[route.method.lower()] = _operation(route)
    error = {
        "type": "object",
        "required": ["error", "exit_code"],
        "properties": {"error": {"type": "string"}, "exit_code": {"type": "integer", "enum": [2, 3, 4]}},
    }
    return {
        "openapi": "3.1.0",
        "info": {"title": "needle-rig daemon", "version": VERSION},
        "paths": paths,
        "components": {"schemas": {**schemas["$defs"], "Error": error}},
    }


def _operation(route: Path) -> JsonObject:
    operation: JsonObject = {
        "operationId": route.order,
        "summary": route.summary,
        "responses": {
            str(route.status): _content("Done, or begun.", {"type": "object"}),
            **{str(status): _content(text, _reference("Error")) for status, text in _REFUSALS.items()},
        },
    }
    if MODELS[route.order] is not Nothing:
        model = MODELS[route.order]
        required = any(field.is_required() for field in model.model_fields.values())
        body = _content("", _reference(model.__name__))["content"]
        operation["requestBody"] = {"required": required, "content": body}
    if route.leased:
        operation["parameters"] = [{"name": "Lease", "in": "header", "schema": {"type": "string"}}]
    return operation


def _content(text: str, schema: JsonObject) -> JsonObject:
    return {"description": text, "content": {"application/json": {"schema": schema}}}


def _reference(name: str) -> JsonObject:
    return {"$ref": _REFERENCE.format(model=name)}
