"""Fields of questions: what each may hold, checked when a question is made."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from needle_rig.errors import BadInput

SHOWN = 60
"""Characters of a wrong value that are shown."""
_NUMBERS: Mapping[type, tuple[type, str]] = {
    bool: (bool, "true or false"),
    int: (Integral, "a whole number"),
    float: (Real, "a number"),
}


@dataclasses.dataclass(frozen=True, slots=True)
class Within:
    """Bounds of a number, both allowed: `Annotated[int, Within(1, 6)]`."""

    low: float
    high: float = float("inf")

    def words(self) -> str:
        """The bounds for a person."""
        return f"at least {self.low:g}" if self.high == float("inf") else f"{self.low:g} to {self.high:g}"


def hints(kind: type[Any]) -> Mapping[str, Any]:
    """The type of each field of a question, with its bounds."""
    known = get_type_hints(kind, include_extras=True)
    return {field.name: known[field.name] for field in dataclasses.fields(kind)}


def defaults(kind: type[Any]) -> dict[str, Any]:
    """The default of each field that has one."""
    made = {
        field.name: field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        for field in dataclasses.fields(kind)
    }
    return {name: value for name, value in made.items() if value is not dataclasses.MISSING}


def taken(place: str, hint: Any, value: Any) -> Any:
    """`value` as a field of type `hint` holds it; a list becomes a tuple. Raises BadInput."""
    origin, args = get_origin(hint), get_args(hint)
    if hint is object:
        return value
    if origin is Annotated:
        number, bounds = taken(place, args[0], value), args[1]
        if not bounds.low <= number <= bounds.high:
            raise BadInput(f"{place} {number}: give {bounds.words()}")
        return number
    if origin is Literal:
        if value not in args:
            raise _wrong(place, value, _words(hint))
        return value
    if origin in (Union, UnionType):
        return _first(place, args, value)
    if origin in (tuple, Sequence):
        if not isinstance(value, Sequence) or isinstance(value, str):
            raise _wrong(place, value, f"a list of {_words(args[0])}")
        parts = args[:1] * len(value) if origin is Sequence else args
        if len(parts) != len(value):
            raise _wrong(place, value, f"{len(parts)} of {_words(args[0])}")
        return tuple(taken(place, part, one) for part, one in zip(parts, value, strict=True))
    if origin is Mapping:
        if not isinstance(value, Mapping):
            raise BadInput(f"{place} is of type {type(value).__name__}; give values by name")
        return {str(key): taken(f"{place}: {key}", args[1], one) for key, one in value.items()}
    accepted, _ = _NUMBERS.get(hint, (origin or hint, ""))
    if not isinstance(value, accepted) or (isinstance(value, bool) and hint is not bool):
        raise _wrong(place, value, _words(hint))
    return value


def _first(place: str, among: tuple[Any, ...], value: Any) -> Any:
    """As the first of several types that takes the value."""
    for hint in among:
        try:
            return taken(place, hint, value)
        except BadInput as refusal:
            if str(refusal).endswith(f"not {_words(hint)}"):
                continue
            raise
    raise _wrong(place, value, " or ".join(dict.fromkeys(map(_words, among))))


def _words(hint: Any) -> str:
    if get_origin(hint) is Annotated:
        return _words(get_args(hint)[0])
    if get_origin(hint) is Literal:
        return " or ".join(get_args(hint))
    if hint is NoneType:
        return "nothing"
    if hint in _NUMBERS:
        return _NUMBERS[hint][1]
    if hint is str:
        return "text"
    return f"a {hint.__name__}" if isinstance(hint, type) else "a path"


def _wrong(place: str, value: Any, words: str) -> BadInput:
    return BadInput(f"{place} is {repr(value)[:SHOWN]}, not {words}")
