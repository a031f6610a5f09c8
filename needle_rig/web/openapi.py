"""The page's server as OpenAPI 3.1: its paths, what is asked of them, and what they answer."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from needle_rig.importing import Mapping as ImportMapping
from needle_rig.model import ChannelErrors
from needle_rig.service.api.documents import Ended, Moved, Rig, Started, State
from needle_rig.service.api.orders import MODELS
from needle_rig.version import VERSION
from needle_rig.web import documents as d
from needle_rig.web.asked import Lesson, RigModel, Work
from needle_rig.web.results import RESULTS, EffectsDocument, LessonDocument
from needle_rig.web.sources import Notes

REFERENCE = "#/components/schemas/"


@dataclass(frozen=True)
class Path:
    """One method of one path."""

    method: str
    path: str
    answer: Any
    """A TypedDict; `Any` for a document whose form is that of its kind, None for a file."""
    asked: type[BaseModel] | None = None


ROUTES = (
    Path("POST", "/api/rig/{order}", Started),
    Path("PUT", "/api/rig_model", d.RigModelDocument, RigModel),
    Path("POST", "/api/estimate", d.EstimateDocument),
    Path("GET", "/api/about", d.AboutDocument),
    Path("GET", "/api/session", d.SessionDocument),
    Path("POST", "/api/session", d.OpenedSession),
    Path("GET", "/api/jobs", d.JobsDocument),
    Path("POST", "/api/jobs", d.BegunJob, Work),
    Path("GET", "/api/results", dict[str, d.JobDocument]),
    Path("GET", "/api/jobs/{key}", d.AnsweredJob),
    Path("DELETE", "/api/jobs/{key}", d.AnsweredJob),
    Path("GET", "/api/jobs/{key}/{name}", None),
    Path("POST", "/api/uploads", d.BegunUpload),
    Path("DELETE", "/api/uploads/{key}", d.EmptyDocument),
    Path("PUT", "/api/uploads/{key}/{path}", d.TakenFile),
    Path("GET", "/api/runs", d.RunsDocument),
    Path("GET", "/api/runs/{name}", d.RunDocument),
    Path("DELETE", "/api/runs/{name}", d.EmptyDocument),
    Path("PUT", "/api/runs/{name}/notes", d.NotesDocument, Notes),
    Path("GET", "/api/watch", d.WatchDocument),
    Path("GET", "/api/trends", d.TrendsDocument),
    Path("GET", "/api/effects", EffectsDocument),
    Path("POST", "/api/lesson", LessonDocument, Lesson),
    Path("GET", "/api/openapi", Any),
)
STREAM = (State, Moved, Ended, Rig)
"""What `/api/live` carries besides, as the daemon writes it."""


@cache
def openapi_document() -> dict[str, Any]:
    """The server as OpenAPI."""
    asked: list[type[BaseModel]] = [Work, Lesson, RigModel, Notes, ChannelErrors, *MODELS.values()]
    _, records = models_json_schema(
        [*((model, "validation") for model in asked), (ImportMapping, "serialization")],
        ref_template=f"{REFERENCE}{{model}}",
    )
    schemas: dict[str, Any] = dict(records["$defs"])
    paths: dict[str, Any] = {}
    for route in ROUTES:
        content = {} if route.answer is None else _content(schema(route.answer, schemas))
        operation: dict[str, Any] = {
            "responses": {
                "200": {"description": "Done, or begun.", **content},
                "default": {"description": "Refused.", **_content(schema(d.ErrorDocument, schemas))},
            }
        }
        if route.asked is not None:
            operation["requestBody"] = _content({"$ref": f"{REFERENCE}{route.asked.__name__}"})
        paths.setdefault(route.path, {})[route.method.lower()] = operation
    for kind in (*STREAM, *RESULTS):
        schema(kind, schemas)
    return {
        "openapi": "3.1.0",
        "info": {"title": "needle-rig page", "version": VERSION},
        "paths": paths,
        "components": {"schemas": dict(sorted(schemas.items()))},
    }


def _content(found: Mapping[str, Any]) -> dict[str, Any]:
    return {"content": {"application/json": {"schema": found}}}


PLAIN = {str: "string", int: "integer", float: "number", bool: "boolean", type(None): "null"}


def schema(kind: Any, known: dict[str, Any]) -> dict[str, Any]:
    """JSON Schema of a type; each TypedDict goes to `known`, by its name. Raises TypeError for another."""
    if kind is Any or kind is object:
        return {}
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return {"$ref": f"{REFERENCE}{kind.__name__}"}
    if kind in PLAIN:
        return {"type": PLAIN[kind]}
    if is_typeddict(kind):
        if kind.__name__ not in known:
            known[kind.__name__] = {}  # it may hold itself
            hints = get_type_hints(kind, include_extras=True)
            # a key that may be missing is known by its hint: the class saw that as text
            needed = {name for name in kind.__required_keys__ if get_origin(hints[name]) is not NotRequired}
            known[kind.__name__] = {
                "type": "object",
                "properties": {name: schema(part, known) for name, part in hints.items()},
                "required": sorted(needed),
            }
        return {"$ref": f"{REFERENCE}{kind.__name__}"}
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Literal:
        return {"enum": list(parts)}
    if origin in (Union, types.UnionType):
        return {"anyOf": [schema(part, known) for part in parts]}
    if origin is list:
        return {"type": "array", "items": schema(parts[0], known)}
    if origin in (dict, Mapping):
        return {"type": "object", "additionalProperties": schema(parts[1], known)}
    if origin is NotRequired:
        return schema(parts[0], known)
    raise TypeError(f"{kind}: has no schema here")
