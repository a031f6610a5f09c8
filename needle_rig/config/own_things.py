"""Where things of one's own live: files below `config/`, and packages that name them as entry points.

A kind is a folder and an entry-point group: `config/effects` and `needle_rig.effects`. An entry point names a
module with one class, as a file holds one; its name is the module's last word.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from needle_rig.config.directories import config_directories
from needle_rig.config.python_file import load_module
from needle_rig.errors import BadInput

Thing = TypeVar("Thing")


@dataclass(frozen=True)
class OwnFile:
    """A file of one's own. `path` is absolute, so that one file is one module wherever a process stands."""

    path: Path

    @property
    def name(self) -> str:
        """The file's name, which is that of the thing."""
        return self.path.stem

    def __str__(self) -> str:
        return str(self.path)

    def module(self) -> ModuleType:
        """The file's module, as the file is now. Raises BadInput with file and line."""
        return load_module(self.path)


@dataclass(frozen=True)
class OwnModule:
    """A module of an installed package, named by an entry point."""

    entry: EntryPoint

    @property
    def name(self) -> str:
        """The entry point's name."""
        return self.entry.name

    @property
    def path(self) -> Path:
        """The module's file, for sentences."""
        return Path(self.module().__file__ or self.entry.module)

    def __str__(self) -> str:
        package = "a package" if self.entry.dist is None else self.entry.dist.name
        return f"entry point {self.name} of {package}"

    def module(self) -> ModuleType:
        """The module. Raises BadInput when it cannot be imported or has another name."""
        if self.entry.attr or self.entry.module.rpartition(".")[2] != self.name:
            raise BadInput(
                f"{self}: {self.entry.value} must be a module whose last word is {self.name};"
                " correct its package"
            )
        try:
            return importlib.import_module(self.entry.module)
        except Exception as error:  # noqa: BLE001 any error of another package becomes one sentence
            raise BadInput(
                f"{self}: {type(error).__name__} while {self.entry.module} is imported: {error};"
                f" correct or uninstall its package"
            ) from None


Source = OwnFile | OwnModule


class Library(dict[str, Thing]):
    """Things by name; `broken` has the sentence of each that cannot be used, and its name.

    `library[name]` raises BadInput with that sentence for a broken one.
    """

    def __init__(self, found: Mapping[str, Thing]) -> None:
        super().__init__(found)
        self.broken: list[tuple[str, str]] = []

    def __missing__(self, name: str) -> Thing:
        for broken, sentence in self.broken:
            if broken == name:
                raise BadInput(sentence)
        raise KeyError(name)


def folders_of(kind: str) -> tuple[Path, ...]:
    """The folders of a kind, nearest first."""
    return tuple(folder / kind for folder in config_directories())


def sources(kind: str, folders: Iterable[str | Path]) -> list[Source]:
    """Every file in `folders` (a missing one is empty), then what packages name. `_shared.py` is a helper."""
    files = (
        OwnFile(folder.resolve() / path.name)
        for folder in dict.fromkeys(Path(each).resolve() for each in folders)
        for path in sorted(folder.glob("*.py"))
        if not path.stem.startswith("_")
    )
    return [*files, *map(OwnModule, _entries(kind))]


def library(
    kind: str,
    shipped: Mapping[str, Thing],
    folders: Iterable[str | Path],
    made: Callable[[ModuleType, Path], Thing],
) -> Library[Thing]:
    """The shipped things and one's own. What is broken, or takes a name, is named and leaves the others."""
    found = Library(shipped)
    origin = dict.fromkeys(shipped, f"a built-in {SINGULAR[kind]}")
    for source in sources(kind, folders):
        try:
            if source.name in origin:
                raise BadInput(
                    f"{_place(source)}: the name {source.name} is taken by {origin[source.name]};"
                    " rename the file"
                )
            found[source.name] = made(source.module(), source.path)
            origin[source.name] = str(source)
        except BadInput as error:
            found.broken.append((source.name, str(error)))
    return found


SINGULAR: Mapping[str, str] = {"effects": "effect", "strategies": "strategy", "devices": "device"}
"""The kinds of things, and what one of them is called."""


def _place(source: Source) -> str:
    return f"{source}:1" if isinstance(source, OwnFile) else str(source)


@cache
def _entries(kind: str) -> tuple[EntryPoint, ...]:
    """Packages do not change while a process runs."""
    return tuple(sorted(entry_points(group=f"needle_rig.{kind}"), key=lambda entry: entry.name))
