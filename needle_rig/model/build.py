"""From values in a file to effects and models; errors name where they stand."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from needle_rig.config.own_things import folders_of
from needle_rig.config.places import Places
from needle_rig.errors import BadInput
from needle_rig.physics.effect import Effect
from needle_rig.physics.effect_text import effect_called
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.records import JsonObject


def effect_directories(extra: Iterable[str | Path] = ()) -> tuple[Path, ...]:
    """Folders with users' effects: `effects` of the config folders, then `extra`."""
    folders = [*folders_of("effects"), *(Path(e) for e in extra)]
    for folder in map(Path, extra):
        if not os.path.isdir(folder):
            raise BadInput(f"{folder}: there is no such folder of effects; name another")
    return tuple(dict.fromkeys(folder.resolve() for folder in folders))


def built_effect(
    library: Mapping[str, type[Effect]],
    name: str,
    values: JsonObject,
    places: Places,
    path: tuple[str, ...],
    inner: tuple[str, ...] = (),
    torque_scale: float = 1.0,
) -> Effect:
    """One effect with its values; errors name where they stand in the file."""
    try:
        effect = effect_called(name, library)
    except BadInput as error:
        raise BadInput(f"{places.of(path, key=True)}: {error}") from None
    known = effect.parameters()
    for key in values:
        if key not in known:
            raise places.error((*path, key), f"{name} has no such parameter; it has {', '.join(known)}")
    for key, value in values.items():
        try:
            effect(**{key: value}).check_for(torque_scale)
        except BadInput as error:
            raise BadInput(f"{places.of((*path, key, *inner))}: {error}") from None
    return effect(**values)


def built_model(places: Places, make: Callable[[], NeedleModel]) -> NeedleModel:
    """What `make` gives; its errors name the file."""
    try:
        return make()
    except BadInput as error:
        raise BadInput(f"{places.of()}: {error}") from None
