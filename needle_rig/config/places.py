"""YAML files with the place of every key and value, and without YAML's surprises.

Numbers, true, false and null are read as in YAML 1.2 (`1e-3` is a number; `on` and `yes` are text); duplicate
keys, foreign tags, merge keys and self-references are refused.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from needle_rig.config import yaml_mistakes
from needle_rig.config.regular_file import read_regular
from needle_rig.errors import BadInput
from needle_rig.records import JsonObject

DataPath = tuple[str | int, ...]
"""Keys and list positions that lead from the top of a file to a value."""

NODE_LIMIT = 200_000
LIMIT_BYTES = 16_000_000
"""Several times what `NODE_LIMIT` values take; bounds text and comments, read at 1 MB a second."""


@dataclass(frozen=True)
class Places:
    """Where each key and value of a file stands (line and column from 1)."""

    file: str
    keys: Mapping[DataPath, tuple[int, int]] = field(default_factory=dict)
    values: Mapping[DataPath, tuple[int, int]] = field(default_factory=dict)
    written: Mapping[DataPath, str] = field(default_factory=dict)
    """Scalars as they are written in the file."""
    options: frozenset[DataPath] = frozenset()
    """Paths whose values came from options of the command instead of the file."""

    def of(self, path: DataPath = (), *, key: bool = False) -> str:
        """`file:line:column` of the value at `path` (of its key, if asked), or of what encloses it."""
        if path in self.options:
            return "option"
        for length in range(len(path), -1, -1):
            part = path[:length]
            found = self.keys.get(part) if key or length < len(path) else None
            found = found or self.values.get(part)
            if found is not None:
                return f"{self.file}:{found[0]}:{found[1]}"
        return self.file

    def error(self, path: DataPath, sentence: str) -> BadInput:
        """The error to raise for what stands at `path`; `sentence` says what is wrong and what to do."""
        name = dotted(path)
        return BadInput(f"{self.of(path)}: {name}: {sentence}" if name else f"{self.of(path)}: {sentence}")


def dotted(path: DataPath) -> str:
    """`layout.hall_sensors[2].name` for ("layout", "hall_sensors", 2, "name")."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def read_yaml(
    path: str | os.PathLike[str], *, inside: str | os.PathLike[str] | None = None
) -> tuple[JsonObject, Places]:
    """The mapping in the YAML file at `path`, and the places of its parts; links must not leave `inside`.

    Raises BadInput, with file, line and column where there are any, for a file that cannot be read.
    """
    shown = show_path(path)
    raw = read_regular(path, shown, LIMIT_BYTES, inside=inside, missing=lambda: _neighbours(Path(path)))
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        raise BadInput(
            f"{shown}:{line}:{column}: byte 0x{raw[error.start]:02x} is not UTF-8; save the file as UTF-8"
        ) from None
    return parse_yaml(text, shown)


def parse_yaml(text: str, name: str) -> tuple[JsonObject, Places]:
    """The mapping in `text`; `name` stands for the file in places and errors. Raises BadInput."""
    try:
        root = yaml.compose(text, Loader=_Loader)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        column = error.position - text.rfind("\n", 0, error.position)
        code = error.character if isinstance(error.character, int) else ord(error.character)
        raise BadInput(f"{name}:{line}:{column}: character U+{code:04X} may not stand in YAML") from None
    except yaml.MarkedYAMLError as error:
        raise BadInput(_syntax_sentence(error, text, name)) from None
    except _TooManyNodes as error:
        raise BadInput(f"{name}:{error.line}: the file holds more than {NODE_LIMIT} values") from None
    except RecursionError:
        raise BadInput(f"{name}: is nested too deeply to be read") from None
    if root is None:
        raise BadInput(f"{name}: the file is empty; a mapping of key: value lines was expected")
    reader = _Reader(name)
    data = reader.value(root, ())
    if not isinstance(data, dict):
        raise BadInput(
            f"{name}:{root.start_mark.line + 1}:{root.start_mark.column + 1}: "
            f"the file holds {kind_of(data)}; a mapping of key: value lines was expected"
        )
    return data, Places(name, reader.keys, reader.values, reader.written)


def write_yaml(data: Mapping[str, Any]) -> str:
    """`data` (plain dicts, lists, text, numbers) as YAML text that `parse_yaml` reads back equal.

    Text with control characters is written too, and refused when it is read.
    """
    return str(
        yaml.dump(
            data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110
        )
    )


def kind_of(value: object) -> str:
    """What a person calls a YAML value of this type."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true or false"
    if isinstance(value, int | float):
        return "a number"
    if isinstance(value, str):
        return "text"
    return "a list" if isinstance(value, list) else "a mapping"


def show_path(path: str | os.PathLike[str]) -> str:
    """`path` as a person would type it here: relative when it is below the working folder."""
    given = os.fspath(path)
    if not os.path.isabs(given):
        return given
    try:
        relative = os.path.relpath(given)
    except (ValueError, OSError):
        return given
    return given if relative.startswith("..") else relative


class _TooManyNodes(Exception):
    def __init__(self, line: int) -> None:
        self.line = line


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self.nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        # The parser takes 20 µs for each value: stop it, rather than judge what it made.
        self.nodes += index is not None  # keys of mappings have none
        if self.nodes > NODE_LIMIT:
            raise _TooManyNodes(self.line + 1)
        return super().compose_node(parent, index)


class _Dumper(yaml.SafeDumper):
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002 as PyYAML calls it
        return True


_UNSHOWABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
_INT = re.compile(r"[-+]?(?:[0-9]+|0x[0-9a-fA-F]+|0o[0-7]+)")
_FLOAT = re.compile(
    r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
)
for _class in (_Loader, _Dumper):
    for _tag, _pattern, _first in (
        ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
        ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
        ("int", _INT.pattern, list("-+0123456789")),
        ("float", _FLOAT.pattern, list("-+0123456789.")),
    ):
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), _first)


class _Reader:
    """Turns composed nodes into plain data and notes where each came from."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.keys: dict[DataPath, tuple[int, int]] = {}
        self.values: dict[DataPath, tuple[int, int]] = {}
        self.written: dict[DataPath, str] = {}
        self.open: set[int] = set()

    def value(self, node: yaml.Node, path: DataPath) -> Any:
        self.values[path] = _place(node)
        if len(self.values) > NODE_LIMIT:
            raise self.refuse(node, f"the file holds more than {NODE_LIMIT} values")
        if isinstance(node, yaml.ScalarNode):
            return self.scalar(node, path)
        if id(node) in self.open:
            raise self.refuse(node, "a value contains itself (an alias inside its own anchor); remove it")
        self.open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode) and node.tag == "tag:yaml.org,2002:map":
                return self.mapping(node, path)
            if isinstance(node, yaml.SequenceNode) and node.tag == "tag:yaml.org,2002:seq":
                return [self.value(item, (*path, index)) for index, item in enumerate(node.value)]
        finally:
            self.open.discard(id(node))
        raise self.refuse(node, f"the tag {node.tag} is not read here; write the value plainly")

    def mapping(self, node: yaml.MappingNode, path: DataPath) -> JsonObject:
        data: JsonObject = {}
        before: yaml.Node | None = None
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise self.refuse(key_node, "a key must be a plain word")
            key = self.shown(key_node)
            here = (*path, key)
            if key == "<<":
                raise self.refuse(key_node, "merge keys (<<) are not read here; write the keys out")
            if before is not None and _touch(before, key_node) and not value_node.value:
                meant = yaml_mistakes.decimal_comma(str(before.value), key)
                if meant:
                    raise self.refuse(before, meant)
            if key in data:
                line, column = self.keys[here]
                raise self.refuse(
                    key_node, f"{dotted(here)} is given twice, first at {self.file}:{line}:{column}; keep one"
                )
            self.keys[here] = _place(key_node)
            data[key] = self.value(value_node, here)
            before = value_node
        return data

    def scalar(self, node: yaml.ScalarNode, path: DataPath) -> Any:
        text = self.written[path] = self.shown(node)
        kind = node.tag.removeprefix("tag:yaml.org,2002:")
        if kind == "str":
            return text
        if kind == "null":
            return None
        if kind == "bool" and text.lower() in ("true", "false"):
            return text.lower() == "true"
        if kind == "int" and _INT.fullmatch(text):
            if len(text) > 40:
                raise self.refuse(node, f"a number of {len(text)} digits cannot be used")
            return int(text, 16 if "x" in text else 8 if "o" in text else 10)
        if kind == "float" and (_INT.fullmatch(text) or _FLOAT.fullmatch(text)):
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        raise self.refuse(node, f"the tag {node.tag} is not read here; write the value plainly")

    def shown(self, node: yaml.ScalarNode) -> str:
        """The text of a scalar; quotes let into YAML what a terminal or a file name cannot bear."""
        text = str(node.value)
        found = _UNSHOWABLE.search(text)
        if found:
            raise self.refuse(node, f"character U+{ord(found[0]):04X} may not stand in a key or value")
        return text

    def refuse(self, node: yaml.Node, sentence: str) -> BadInput:
        line, column = _place(node)
        return BadInput(f"{self.file}:{line}:{column}: {sentence}")


def _place(node: yaml.Node) -> tuple[int, int]:
    return node.start_mark.line + 1, node.start_mark.column + 1


def _touch(before: yaml.Node, after: yaml.Node) -> bool:
    """Whether one character, a comma in braces, stands between two plain scalars."""
    plain = isinstance(before, yaml.ScalarNode) and before.style is None
    return plain and int(after.start_mark.index) == int(before.end_mark.index) + 1


def _neighbours(path: Path) -> str:
    try:
        names = sorted(p.name for p in path.parent.iterdir() if p.suffix in (".yaml", ".yml"))
    except OSError:
        return f"; nor is there a folder {show_path(path.parent)}"
    return f"; {show_path(path.parent)} has {', '.join(names[:8])}" if names else ""


def _syntax_sentence(error: yaml.MarkedYAMLError, text: str, name: str) -> str:
    mark = error.problem_mark or error.context_mark
    if mark is None:
        return f"{name}: is not YAML: {error.problem}"
    opened = error.context_mark.line if error.context_mark is not None else None
    said = yaml_mistakes.sentence(error.problem or "", text, (mark.line, mark.column), opened)
    return f"{name}:{mark.line + 1}:{mark.column + 1}: {said}"
