"""Data from a YAML file held against a pydantic model; every error with its place and a hint."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from needle_rig.config.file_kinds import as_read_here
from needle_rig.config.hints import meant_key, meant_value, number, number_from_text, symbol
from needle_rig.config.places import DataPath, Places, dotted, kind_of
from needle_rig.errors import BadInput
from needle_rig.records import JsonObject

MOST_SENTENCES = 20
"""What fills a screen; a line in a wrong place makes every key below it unknown."""

Model = TypeVar("Model", bound=BaseModel)


def validate(model: type[Model], data: JsonObject, places: Places) -> Model:
    """`data` as a `model`, nothing converted silently (text is no number, `yes` is not true).

    An older format is migrated first. Raises BadInput with one line for every error, in the order of the
    file; one line alone for a file of another format.
    """
    stated = model.model_fields.get("format")
    if stated is not None and "format" in data:
        data = as_read_here(data, places, *get_args(stated.annotation))
    try:
        return model.model_validate_json(json.dumps(data), strict=True)
    except ValidationError as failed:
        errors = failed.errors(include_url=False)
    explained: set[DataPath] = set()
    missing: dict[DataPath, list[str]] = {}
    lines: list[tuple[tuple[int, int], str]] = []
    for error in sorted(errors, key=lambda e: e["type"] == "missing"):
        path = _place(error, data)
        if error["type"] == "missing" and isinstance(path[-1], str):
            if path not in explained:
                missing.setdefault(path[:-1], []).append(path[-1])
            continue
        unknown = error["type"] == "extra_forbidden"
        anchor = path[:-1] if error["type"] == "missing" else path
        position = (places.keys if unknown else places.values).get(anchor, (0, 0))
        sentence = _sentence(error, path, model, data, places, explained)
        lines.append((position, f"{places.of(anchor, key=unknown)}: {sentence}"))
    for path, keys in missing.items():
        inside = f"{dotted(path)}: " if path else ""
        verb, them = ("is", "it") if len(keys) == 1 else ("are", "them")
        sentence = f"{places.of(path)}: {inside}{', '.join(keys)} {verb} missing; add {them}"
        lines.append((places.values.get(path, (0, 0)), sentence))
    told = [line for _, line in sorted(lines, key=lambda entry: entry[0])]
    if len(told) > MOST_SENTENCES:
        told[MOST_SENTENCES:] = [f"{places.file}: and {len(told) - MOST_SENTENCES} more; mend these first"]
    raise BadInput("\n".join(told))


def _place(error: ErrorDetails, data: Any) -> DataPath:
    """Keys and positions that lead to the error; pydantic also names the members of a union on the way."""
    path: list[str | int] = []
    for part in error["loc"]:
        listed = isinstance(data, list) and isinstance(part, int) and part < len(data)
        if listed or (isinstance(data, dict) and part in data):
            data = data[part]
        elif error["type"] != "missing" or part != error["loc"][-1]:
            continue
        path.append(part)
    return tuple(path)


def _sentence(
    error: ErrorDetails,
    path: DataPath,
    model: type[BaseModel],
    data: JsonObject,
    places: Places,
    explained: set[DataPath],
) -> str:
    name, kind, value = dotted(path), error["type"], error["input"]
    key = next((str(part) for part in reversed(path) if isinstance(part, str)), "")
    context = error.get("ctx", {})
    shown = places.written.get(path, "") if isinstance(value, int | float) else repr(value)
    shown = shown or (number(value) if isinstance(value, int | float) else repr(value))
    if kind == "extra_forbidden":
        section = _model_at(model, path[:-1], data)
        present = _data_at(data, path[:-1])
        allowed = list(section.model_fields) if section else []
        meant = meant_key(key, value, allowed, present)
        if meant:
            explained.add((*path[:-1], meant[0]))
            return f"{name}: unknown key; {meant[1]}"
        free = [k for k in allowed if k not in present]
        return f"{name}: unknown key; " + (
            f"not yet given here: {', '.join(free)}" if free else "every known key of this section is given"
        )
    if kind == "missing":
        return f"{dotted(path[:-1])}: value number {int(path[-1]) + 1} of the list is missing; add it"
    if kind == "too_long":
        return f"{name}: {shown} has {context['actual_length']} values; give {context['max_length']}"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        return f"{name}: {shown} {_range(kind, key, float(value), context)}"
    if kind == "finite_number":
        return f"{name}: {shown} is not a finite number; give one{' in' + symbol(key) if symbol(key) else ''}"
    if kind == "literal_error":
        return f"{name}: {shown} is not one of {context['expected']}"
    wanted = _WANTED.get(kind)
    if wanted is None:
        return f"{name}: {error['msg'][:1].lower()}{error['msg'][1:]} (it is {shown})"
    if isinstance(value, str):
        return f"{name}: {shown} is text, not {wanted}{_text_hint(kind, key, value)}"
    if isinstance(value, bool):
        return f"{name}: {'true' if value else 'false'} stands where {wanted} is expected"
    if isinstance(value, int | float) and kind == "string_type":
        return f"{name}: {shown} is {kind_of(value)}, not text; put it in quotes"
    if isinstance(value, float) and kind.startswith("int_"):
        near = f"write {round(value)}" if math.isfinite(value) else "write one"
        return f"{name}: {shown} is not a whole number; {near}"
    return f"{name}: {kind_of(value)} stands where {wanted} is expected"


_WANTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
}


def _text_hint(kind: str, key: str, text: str) -> str:
    if kind == "bool_type":
        meaning = {"on": "true", "yes": "true", "y": "true", "off": "false", "no": "false", "n": "false"}
        return f"; write {meaning.get(text.lower(), 'true or false')}"
    return number_from_text(key, text) if kind.startswith(("float", "int")) else ""


def _range(kind: str, key: str, value: float, context: Mapping[str, float]) -> str:
    unit = symbol(key)
    if kind.startswith("greater"):
        limit = context["gt" if kind == "greater_than" else "ge"]
        strict = kind == "greater_than"
        words = f"is not above {number(limit)}{unit}" if strict else f"is below {number(limit)}{unit}"
        return words + meant_value(key, value, limit, None, strict=strict)
    limit = context["lt" if kind == "less_than" else "le"]
    words = "is not below" if kind == "less_than" else "is above"
    return f"{words} {number(limit)}{unit}" + meant_value(key, value, 0.0, limit, strict=True)


def _model_at(model: type[BaseModel], path: DataPath, data: Any) -> type[BaseModel] | None:
    """The model of the section at `path` of `data`, looking through tuples, dicts and unions."""
    found: Any = model
    for part in path:
        section, data = data, data[part]
        found = _inside(found, part, section)
    return _chosen(_models_in(found), data)


def _inside(annotation: Any, part: str | int, section: Any) -> Any:
    """The annotation of what stands at `part` of a section of the type `annotation`; None if nobody knows."""
    several = [a for a in _options(annotation) if get_origin(a) in (dict, tuple, list)]
    if several:
        return get_args(several[0])[1 if get_origin(several[0]) is dict else 0]
    chosen = _chosen(_models_in(annotation), section)
    field = chosen.model_fields.get(str(part)) if chosen else None
    return field.annotation if field else None


def _options(annotation: Any) -> list[Any]:
    """The members of a union, without what is only noted of them."""
    if get_origin(annotation) is Annotated:
        return _options(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [option for a in get_args(annotation) for option in _options(a)]
    return [annotation]


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    return [a for a in _options(annotation) if isinstance(a, type) and issubclass(a, BaseModel)]


def _chosen(models: list[type[BaseModel]], data: Any) -> type[BaseModel] | None:
    """Of several models the one that the section's word `device` names, if they have one; else the first."""
    if len(models) < 2:
        return models[0] if models else None
    word = data.get("device", "node") if isinstance(data, dict) else ""
    named = [m.model_fields.get("device") for m in models]
    fits = (
        m for m, field in zip(models, named, strict=True) if not field or word in get_args(field.annotation)
    )
    return next(fits, None)


def _data_at(data: Any, path: DataPath) -> JsonObject:
    for part in path:
        data = data[part]
    return data if isinstance(data, dict) else {}
