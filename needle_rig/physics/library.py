"""The library of effects: one file each, found by name in the package and among one's own things.

There is no registry: the file's name is the effect's name. A user's file passes the same checks as a
built-in one and gets one sentence with file and line when something is missing.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import math
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import ModuleType

from needle_rig.config.hints import key_endings, split_unit
from needle_rig.config.own_things import Library, OwnFile, library
from needle_rig.config.python_file import the_subclass
from needle_rig.errors import BadInput
from needle_rig.physics import effects as built_in
from needle_rig.physics.effect import Effect, ParameterInfo

HOOKS: dict[str, tuple[str, ...]] = {
    "shape": ("self", "rod", "trial"),
    "torque": ("self", "angle_rad", "rate_rad_s", "time_s", "position_m"),
    "drive": ("self", "trial"),
    "observe": ("self", "reading"),
}


def find_effects(user_directories: Iterable[str | Path] = ()) -> Library[type[Effect]]:
    """Every effect by name: the built-in ones, those in `user_directories`, and those of packages.

    A file that is no effect, or takes the name of another, stands in `broken` with its sentence.
    """
    return library("effects", built_in_effects(), user_directories, effect_in)


@cache
def built_in_effects() -> dict[str, type[Effect]]:
    """The effects that come with the package, by name."""
    folder = Path(built_in.__path__[0])
    names = sorted(path.stem for path in folder.glob("*.py") if not path.stem.startswith("_"))
    return {
        name: effect_in(importlib.import_module(f"{built_in.__name__}.{name}"), folder / f"{name}.py")
        for name in names
    }


def load_effect(path: Path) -> type[Effect]:
    """The effect in the file `path`. Raises BadInput with file and line when it is missing or broken."""
    file = OwnFile(path.parent.resolve() / path.name)
    return effect_in(file.module(), file.path)


def effect_in(module: ModuleType, path: Path) -> type[Effect]:
    """The one Effect subclass that `module` defines, checked. Raises BadInput with file and line."""
    found: type[Effect] = the_subclass(module, Effect, "an effect", path)
    _check(found, path)
    return found


def _check(effect: type[Effect], path: Path) -> None:
    """Raises BadInput for what an effect must have and this one lacks."""
    place = f"{path}:{inspect.getsourcelines(effect)[1]}: {effect.__name__}"
    parameters = getattr(effect, "__dataclass_params__", None)
    if parameters is None or "__dataclass_fields__" not in vars(effect) or not parameters.frozen:
        raise BadInput(f"{place} is not a frozen dataclass; put @dataclass(frozen=True) above it")
    fields = dataclasses.fields(effect)  # type: ignore[arg-type]
    if not fields:
        raise BadInput(f"{place} has no parameter; give it a field made by parameter(...)")
    for field in fields:
        info = field.metadata.get("info")
        if not isinstance(info, ParameterInfo):
            raise BadInput(
                f"{place}.{field.name} has no bounds and unit; make it by parameter(off=…, unit=…)"
            )
        _check_info(info, f"{place}.{field.name}")
        _check_name(field.name, info.unit, place)
    if all(field.metadata["info"].shapes for field in fields):
        raise BadInput(f"{place} has no parameter with an off value; one must not be `shapes`")
    if sum(field.metadata["info"].places is not None for field in fields) > 1:
        raise BadInput(f"{place} has several parameters with places; one at most can be tried")
    hooks = [hook for hook in HOOKS if effect.has(hook)]
    if not hooks:
        raise BadInput(f"{place} has none of the hooks {', '.join(HOOKS)}; define one")
    for hook in hooks:
        method = getattr(effect, hook)
        if tuple(inspect.signature(method).parameters) != HOOKS[hook]:
            line = inspect.getsourcelines(method)[1]
            raise BadInput(f"{path}:{line}: {hook} must be def {hook}({', '.join(HOOKS[hook])})")
    text = inspect.getdoc(sys.modules[effect.__module__]) or ""
    for word in ("Law:", "Source:", "Shows best:"):
        if word not in text:
            raise BadInput(f'{path}:1: the text at the top of the file has no "{word}"; say it there')


def _check_name(name: str, unit: str, place: str) -> None:
    """Raises BadInput when the name of a parameter says another unit than the parameter has."""
    endings = key_endings(unit)
    stem, said, _ = split_unit(name.lower())
    if endings:
        fits = any(name == ending or name.endswith(f"_{ending}") for ending in endings)
        wanted = f"{stem}_{endings[0]}"
    else:
        fits, wanted = not said, stem
    if not fits:
        raise BadInput(f"{place}.{name}: its unit is {unit}, which its name does not say; call it {wanted}")


def _check_info(info: ParameterInfo, place: str) -> None:
    """Raises BadInput when the numbers of a parameter contradict each other."""
    low, high = info.literature
    if not info.lower < info.upper:
        raise BadInput(f"{place}: lower {info.lower:g} is not below upper {info.upper:g}")
    for name, value in (("typical", info.typical), ("literature", low), ("literature", high)):
        if not info.lower <= value <= info.upper:
            raise BadInput(f"{place}: {name} {value:g} is outside {info.lower:g} to {info.upper:g}")
    if not info.unit:
        raise BadInput(f"{place}: no unit; give it one (1 for a plain ratio)")
    if info.relative and (info.per == "one" or not 0.0 < info.off < math.inf):
        raise BadInput(f"{place}: relative is for factors, one per sensor or section, that are off at 1")
    if info.places is not None and not (info.shapes and info.per == "one"):
        raise BadInput(f"{place}: places are tried of a single number that gives form; add shapes=True")
    if not info.shapes and info.typical == info.off:
        raise BadInput(f"{place}: typical equals off ({info.off:g}); give the size that the effect has")
