"""What there is to name: effects, parameter sets."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

from needle_rig.errors import BadInput
from needle_rig.model import ParameterSet, load_parameter_set, parameter_sets
from needle_rig.notebook.asking import PathLike, several
from needle_rig.notebook.shown import Shown
from needle_rig.notebook.tables import Table, table_of
from needle_rig.physics.effect import Effect
from needle_rig.questions.doing import SILENT
from needle_rig.questions.question import Question

Thing = TypeVar("Thing")


class _ByName(Shown, Mapping[str, Thing]):
    """Things by name."""

    def __init__(self, found: Mapping[str, Thing]) -> None:
        self._found = dict(found)

    def __getitem__(self, name: str) -> Thing:
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)


class Effects(_ByName[type[Effect]]):
    """Effects by name."""

    def headline(self) -> str:
        """How many there are."""
        return f"{len(self)} effects: {', '.join(self)}"

    def table(self) -> Table:
        """A row a parameter of each effect, with the unit of files and what is typical."""
        return table_of(
            {
                "effect": name,
                "parameter": field,
                "unit": info.unit,
                "typical": info.typical,
                "lower": info.lower,
                "upper": info.upper,
                "law": _first_line(effect),
            }
            for name, effect in self.items()
            for field, info in effect.parameters().items()
        )


class ParameterSets(_ByName[ParameterSet]):
    """Published parameter sets by name."""

    def headline(self) -> str:
        """How many there are."""
        return f"{len(self)} parameter sets: {', '.join(self)}"

    def table(self) -> Table:
        """A row a set: title, source, rigidity, effects."""
        return table_of(
            {
                "name": name,
                "title": found.title,
                "torsional_rigidity_nmm2": found.torsional_rigidity_nmm2,
                "effects": ", ".join(found.effects),
                "source": found.source,
            }
            for name, found in self.items()
        )


def effects(*folders: PathLike) -> Effects:
    """Every effect by name, those of further `folders` among them. Raises BadInput."""
    return Effects(_library(folders))


def parameters() -> ParameterSets:
    """Every parameter set by name. Raises BadInput."""
    return ParameterSets({name: load_parameter_set(path) for name, path in parameter_sets().items()})


def hidden_effects(
    given: Mapping[str, float | Mapping[str, float]], folders: Sequence[PathLike]
) -> list[Effect]:
    """Effects with values, `{"tissue_elasticity": 0.35}`. Raises BadInput for what there is not."""
    if not isinstance(given, Mapping):
        raise BadInput(
            f'effects is of type {type(given).__name__}; name values, as in {{"tissue_elasticity": 0.35}}'
        )
    known, made = _library(folders), []
    for name, value in given.items():
        if name not in known:
            raise BadInput(f"{name}: no such effect; there are {', '.join(sorted(known))}")
        infos = known[name].parameters()
        fields: dict[str, Any] = dict(value) if isinstance(value, Mapping) else {next(iter(infos)): value}
        for field, number in fields.items():
            if field not in infos:
                raise BadInput(f"{name} has no {field}; it has {', '.join(infos)}")
            several = number if isinstance(number, Sequence) and not isinstance(number, str) else (number,)
            if not all(isinstance(one, int | float) for one in several):
                raise BadInput(f"{name}: {field} is {number!r}, not a number; give it in {infos[field].unit}")
        made.append(known[name](**fields))
    return made


def _library(folders: Sequence[PathLike]) -> Mapping[str, type[Effect]]:
    return Question(effects=several(folders)).library(SILENT)


def _first_line(effect: type[Effect]) -> str:
    text = inspect.getdoc(sys.modules[effect.__module__]) or ""
    return text.split("\n", 1)[0]
