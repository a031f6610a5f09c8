"""Tables of the site that are made from the code: commands, configuration, effects, parameter sets, API."""

from __future__ import annotations

import ast
import html
import importlib
import inspect
import textwrap
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

ROOT = Path(__file__).parents[2]


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "&#124;") for cell in line) + " |" for line in lines)


def _code(text: str) -> str:
    return f"<code>{html.escape(text)}</code>"


def _config() -> str:
    from needle_rig.config.schema import RigConfig

    parts = []
    for name, model in _sections(RigConfig):
        text = inspect.getdoc(model) or ""
        texts = _field_texts(model)
        rows = [
            [f"`{key}`", _kind(field), _default(field), texts.get(key, "")]
            for key, field in model.model_fields.items()
        ]
        parts.append(f"## {name}\n\n{text}\n\n" + _table(["key", "value", "default", ""], rows))
    return "\n\n".join(parts)


def _sections(model: type[BaseModel], name: str = "top level") -> Iterator[tuple[str, type[BaseModel]]]:
    yield name, model
    for key, field in model.model_fields.items():
        section = key if name == "top level" else f"{name}.{key}"
        inner = _models_in(field.annotation)
        for each in inner:
            yield from _sections(each, section if len(inner) == 1 else f"{section}: {_word(each)}")


def _word(model: type[BaseModel]) -> str:
    """Which value of its key `device` names this section among several."""
    words = typing.get_args(model.model_fields["device"].annotation)
    return str(words[0]) if words else "NAME"


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for a in typing.get_args(annotation) for model in _models_in(a)]


def _kind(field: Any) -> str:
    inner = _models_in(field.annotation)
    if len(inner) > 1:
        return f"one of the {len(inner)} sections below"
    if inner:
        several = typing.get_origin(field.annotation) is tuple
        return "a list of the section below" if several else "a section, below"
    if typing.get_origin(field.annotation) is typing.Literal:
        return " or ".join(f"`{value}`" for value in typing.get_args(field.annotation))
    names = {float: "number", int: "whole number", str: "text", bool: "`true` or `false`"}
    every = typing.get_args(field.annotation) or (field.annotation,)
    kind = next((names[a] for a in every if a in names), "a list of [start, end]")
    limits = [*field.metadata, *(m for a in every for m in getattr(a, "__metadata__", ()))]
    words = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}
    told = [
        f"{words[sign]} {getattr(limit, sign):g}"
        for entry in limits
        for limit in getattr(entry, "metadata", [entry])
        for sign in words
        if getattr(limit, sign, None) is not None
    ]
    return " ".join([kind, *told])


def _default(field: Any) -> str:
    if isinstance(field.default, BaseModel):
        return f"`{field.default.model_dump()}`".replace("'", "")
    return "needed" if field.is_required() else "–" if field.default is None else f"`{field.default}`"


def _field_texts(model: type[BaseModel]) -> dict[str, str]:
    """The sentence under each field, as it stands in the source."""
    body = ast.parse(textwrap.dedent(inspect.getsource(model))).body[0]
    found: dict[str, str] = {}
    last = ""
    for line in getattr(body, "body", []):
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
            last = line.target.id
        elif last and isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant):
            found[last] = " ".join(str(line.value.value).split())
            last = ""
    return found


def _routes() -> str:
    from needle_rig.service.api.openapi import ROUTES
    from needle_rig.service.api.orders import MODELS

    rows = []
    for route in ROUTES:
        fields = MODELS[route.order].model_fields
        content = ", ".join(f"`{name}`" + ("" if f.is_required() else "?") for name, f in fields.items())
        rows.append(
            [
                f"`{route.method} {route.path}`",
                route.summary,
                content,
                str(route.status),
                "yes" if route.leased else "",
            ]
        )
    return _table(["path", "", "content (? may be left out)", "answer", "lease"], rows)


def _orders() -> str:
    from needle_rig.service.api.orders import MODELS

    parts = []
    for model in dict.fromkeys(m for m in MODELS.values() if m.model_fields):
        rows = []
        for name, shown in model.model_json_schema()["properties"].items():
            branches = shown.get("anyOf", [shown])
            kinds = [_schema_words(b) for b in branches if b.get("type") != "null"]
            rows.append(
                [
                    f"`{name}`",
                    " or ".join(dict.fromkeys(kinds)),
                    "needed"
                    if "default" not in shown
                    else "–"
                    if shown["default"] is None
                    else f"`{shown['default']}`",
                ]
            )
        parts.append(
            f"**{model.__name__}**: {(model.__doc__ or '').strip()}\n\n"
            + _table(["value", "kind", "default"], rows)
        )
    return "\n\n".join(parts)


def _schema_words(schema: dict[str, Any]) -> str:
    if "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema["enum"])
    words = [str(schema.get("type", "value")).replace("integer", "whole number").replace("string", "text")]
    words += [
        f"{word} {schema[key]:g}" for key, word in (("minimum", "from"), ("maximum", "to")) if key in schema
    ]
    words += [f"up to {schema[key]} letters" for key in ("maxLength",) if key in schema]
    words += (
        [f"matching `{schema['pattern']}`"] if "pattern" in schema and len(schema["pattern"]) < 24 else []
    )
    return " ".join(words)


def _parameter_sets() -> str:
    import yaml

    parts = []
    for path in sorted((ROOT / "config" / "parameters").glob("*.yaml")):
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
        lines = [f"## {data['name']}", f"{data['title']}.", f"Source: {data['source'].strip()}"]
        for title, key in (("Reproduces", "reproduces"), ("Does not reproduce", "does_not_reproduce")):
            lines.append(f"{title}:\n\n" + "\n".join(f"- {each}" for each in data[key]))
        parts += lines
    return "\n\n".join(parts)


def _number(value: float) -> str:
    return f"{value:g}".replace("inf", "∞").replace("-", "−")


def _effects() -> str:
    from needle_rig.physics.library import find_effects

    parts = []
    for name, effect in sorted(find_effects().items()):
        text = importlib.import_module(effect.__module__).__doc__ or ""
        paragraphs = [" ".join(part.split()) for part in text.strip().split("\n\n")]
        rows = [
            [
                f"`{field}`",
                info.unit,
                *(_number(v) for v in (info.off, info.typical, info.smallest)),
                f"{_number(info.literature[0])} … {_number(info.literature[1])}",
                {"one": "", "sensor": "a sensor", "section": "a section"}[info.per],
            ]
            for field, info in effect.parameters().items()
        ]
        hooks = [hook for hook in ("shape", "torque", "drive", "observe") if effect.has(hook)]
        head = ["parameter", "unit", "off", "typical", "smallest that matters", "plausible", "one for"]
        parts += [
            f"## {name}",
            *paragraphs,
            _table(head, rows),
            f"Hooks: {', '.join(f'`{h}`' for h in hooks)}.",
        ]
    return "\n\n".join(parts)


def _commands() -> str:
    import click

    from needle_rig.cli.main import group

    def told(command: click.Command, path: str, depth: int) -> Iterator[str]:
        context = click.Context(command, info_name=path)
        yield f"{'#' * depth} {path.removeprefix('needle-rig ')}"
        yield f"```\n{command.get_usage(context).removeprefix('Usage: ')}\n```"
        for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
            as_it_is = paragraph.startswith("\b")
            yield "```\n" + paragraph[2:] + "\n```" if as_it_is else paragraph.replace("<", "&lt;")
        options = [p for p in command.params if isinstance(p, click.Option)]
        rows = [record for option in options if (record := option.get_help_record(context))]
        if rows:
            yield _table(["option", ""], [[_code(name), html.escape(said)] for name, said in rows])
        if isinstance(command, click.Group):
            for name in command.list_commands(context):
                inner = command.get_command(context, name)
                if inner is not None:
                    yield from told(inner, f"{path} {name}", depth + (depth > 2 or path != "needle-rig"))

    return "\n\n".join(told(group, "needle-rig", 2))


def _thresholds() -> str:
    from needle_rig.workbench.policy import POLICY, thresholds

    rows = []
    for row in thresholds(POLICY):
        guard = (Path("tests/workbench") / row.guard).as_posix().replace("workbench/../", "")
        named = _code(f"{row.group}.{row.name}")
        rows.append(
            [named, html.escape(str(row.value)), *map(html.escape, (row.reason, row.source)), _code(guard)]
        )
    return _table(["threshold", "value", "meaning", "source", "guarded by"], rows)


TABLES: dict[str, Callable[[], str]] = {
    "commands": _commands,
    "config": _config,
    "routes": _routes,
    "orders": _orders,
    "parameter-sets": _parameter_sets,
    "effects": _effects,
    "thresholds": _thresholds,
}
