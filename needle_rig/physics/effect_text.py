"""Effects as a person writes them on a command line.

`name=0.35` sets the first field, `name=0.35,1.2` further fields in order; when the first field has one value
per sensor or section, the comma list is its list. `name:field=value` sets a named field, and `name` alone
takes the typical size.
"""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterable, Mapping

from needle_rig.config.yaml_mistakes import decimal_comma
from needle_rig.errors import BadInput
from needle_rig.physics.effect import Effect

Parameter = float | tuple[float, ...]
"""One number, or one for each sensor or section."""


def parse_effects(texts: Iterable[str], library: Mapping[str, type[Effect]]) -> tuple[Effect, ...]:
    """The effects that `texts` name; texts of one name add up. Raises BadInput."""
    given: dict[str, dict[str, Parameter]] = {}
    for text in texts:
        left, equals, right = text.partition("=")
        name, _, field = left.strip().partition(":")
        effect = effect_called(name, library)
        values = given.setdefault(name, {})
        if not equals:
            if field:
                raise BadInput(f"effect {text}: {field} has no value; write {name}:{field}=VALUE")
            values |= _plain(effect.at_strength(1.0))
            continue
        numbers = [_number(part, text) for part in right.split(",")]
        values |= _fields(effect, field, numbers, text)
    made = tuple(library[name](**values) for name, values in given.items())
    for each in made:
        each.check_for(1.0)
    return made


def effect_called(name: str, library: Mapping[str, type[Effect]]) -> type[Effect]:
    """The effect `name`. Raises BadInput with the nearest names when there is none, or why it is broken."""
    with contextlib.suppress(KeyError):
        return library[name]
    near = difflib.get_close_matches(name, library, n=1)
    meant = f"did you mean {near[0]}?" if near else f"there are {', '.join(sorted(library))}"
    raise BadInput(f"there is no effect {name}; {meant}")


def _fields(effect: type[Effect], field: str, numbers: list[float], text: str) -> dict[str, Parameter]:
    infos = effect.parameters()
    if field and field not in infos:
        raise BadInput(f"effect {text}: {effect.name()} has no {field}; it has {', '.join(infos)}")
    first = field or next(iter(infos))
    if len(numbers) == 1:
        return {first: numbers[0]}
    if infos[first].per != "one":
        return {first: tuple(numbers)}
    if field or len(numbers) > len(infos):
        given = text.partition("=")[2]
        meant = decimal_comma(*given.split(",", 1))
        hint = f"; {meant}" if meant else ""
        raise BadInput(
            f"effect {text}: {len(numbers)} values for {1 if field else len(infos)}"
            f" field(s) ({first if field else ', '.join(infos)}){hint}"
        )
    return dict(zip(infos, numbers, strict=False))


def _number(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise BadInput(f"effect {whole}: {text!r} is not a number; write NAME=VALUE") from None


def _plain(effect: Effect) -> dict[str, Parameter]:
    return {name: getattr(effect, name) for name in effect.parameters()}
