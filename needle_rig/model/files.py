"""Model files: what was learnt, with uncertainties and how it came about."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from needle_rig.config.check import validate
from needle_rig.config.hints import key_endings
from needle_rig.config.places import DataPath, Places, parse_yaml, read_yaml, write_yaml
from needle_rig.model.build import built_effect, built_model, effect_directories
from needle_rig.model.schema import MODEL_FORMAT, FittedValue, HistoryEntry, ModelFile
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import (
    BASE_PARAMETERS,
    FRICTION,
    NMM2_PER_NM2,
    TORSIONAL_RIGIDITY,
    NeedleModel,
)
from needle_rig.physics.rod import Layout
from needle_rig.records import JsonObject
from needle_rig.units import m, mm, per_length_n
from needle_rig.version import VERSION


@dataclass(frozen=True)
class SavedModel:
    """A model with what a model file knows beside it.

    `uncertainties` are standard deviations by parameter name (names and units of `NeedleModel.values`),
    `correlations` those of pairs of parameters; a pair that is not there has none.
    """

    model: NeedleModel
    starts_from: str
    uncertainties: Mapping[str, float] = field(default_factory=dict)
    history: tuple[HistoryEntry, ...] = ()
    correlations: Mapping[tuple[str, str], float] = field(default_factory=dict)

    @property
    def error_over_floor(self) -> float | None:
        """Largest error of a channel on held-out runs over its floor, from the last entry that tells both."""
        for entry in reversed(self.history):
            told = [
                e.held_out_after / e.floor
                for e in entry.errors.values()
                if e.held_out_after is not None and e.floor
            ]
            if told:
                return max(told)
        return None


def load_model(path: str | os.PathLike[str], *, effects: Iterable[str | Path] = ()) -> SavedModel:
    """A model file with its uncertainties and history. Raises BadInput with file and line."""
    data, places = read_yaml(path)
    return saved_model(data, places, effects)


def model_in(text: str, named: str, *, effects: Iterable[str | Path] = ()) -> SavedModel:
    """The model in the text of a model file, which errors call `named`. Raises BadInput with the line."""
    data, places = parse_yaml(text, named)
    return saved_model(data, places, effects)


def save_model(path: str | os.PathLike[str], saved: SavedModel) -> None:
    """Write a model file, whole or not at all; `load_model` gives back an equal one."""
    write_whole(path, model_mapping(saved))


def write_whole(path: str | os.PathLike[str], data: JsonObject) -> None:
    """Write `data` as a YAML file, whole or not at all."""
    target = Path(path)
    temporary = target.with_name(f".{target.name}.new")
    temporary.write_text(write_yaml(data), encoding="utf-8")
    temporary.replace(target)


def model_mapping(saved: SavedModel) -> JsonObject:
    """What stands in a model file; `saved_model` gives back an equal one."""
    model = saved.model
    values = model.values()

    def fitted(name: str) -> JsonObject:
        entry: JsonObject = {"value": values[name]}
        if name in saved.uncertainties:
            entry["uncertainty"] = float(saved.uncertainties[name])
        return entry | {"unit": model.info(name).unit}

    def fitted_list(names: list[str], unit: str) -> JsonObject:
        entry: JsonObject = {"value": [values[name] for name in names]}
        if any(name in saved.uncertainties for name in names):
            entry["uncertainty"] = [saved.uncertainties.get(name) for name in names]
        return entry | {"unit": unit}

    effects: dict[str, JsonObject] = {}
    for effect in model.effects:
        fields = effects.setdefault(effect.name(), {})
        for name, info in effect.parameters().items():
            place = f"{effect.name()}.{name}"
            if info.per == "one":
                fields[name] = fitted(place)
            else:
                items = [f"{place}[{i}]" for i in range(model.count(info))]
                fields[name] = fitted_list(items, info.unit)
    layout = model.layout
    return {
        "format": MODEL_FORMAT,
        "written_by": VERSION,
        "name": model.name,
        "starts_from": saved.starts_from,
        **({} if model.torque_scale == 1.0 else {"torque_scale": model.torque_scale}),
        "layout": {
            "needle_length_mm": _tidy(layout.needle_length_m),
            "tissue_sections_mm": [[_tidy(a), _tidy(b)] for a, b in layout.tissue_sections_m],
            "sensor_positions_mm": [_tidy(x) for x in layout.sensor_positions_m],
            **(
                {"segments": [[_tidy(a), _tidy(b), of] for a, b, of in layout.segments]}
                if layout.segments
                else {}
            ),
            **({"tip_clamped": True} if layout.tip_clamped else {}),
        },
        "base": {name: fitted(name) for name in BASE_PARAMETERS},
        "effects": effects,
        **(
            {"correlations": [{"of": list(of), "value": float(r)} for of, r in saved.correlations.items()]}
            if saved.correlations
            else {}
        ),
        "history": [entry.model_dump(mode="json", exclude_none=True) for entry in saved.history],
    }


def _tidy(length_m: float) -> float:
    """Millimetres without the last bits of the conversion: 175.0, not 174.99999999999997."""
    return round(mm(length_m), 9)


def saved_model(data: JsonObject, places: Places, effects: Iterable[str | Path]) -> SavedModel:
    """The model in the mapping of a model file. Raises BadInput with file and line."""
    found = validate(ModelFile, data, places)
    for name in BASE_PARAMETERS:
        if name not in found.base:
            raise places.error(("base",), f"{name} is missing; add it")
    for name in found.base:
        if name not in BASE_PARAMETERS:
            raise places.error(("base", name), f"unknown; there are {', '.join(BASE_PARAMETERS)}")
    library = find_effects(effect_directories(effects)) if found.effects else {}
    made: list[Effect] = []
    for name, stated in found.base.items():
        _check_unit(stated.unit, BASE_PARAMETERS[name].unit, places, ("base", name))
    uncertainties = {n: v.uncertainty for n, v in found.base.items() if v.uncertainty is not None}
    for name, fields in found.effects.items():
        values = {key: entry.value for key, entry in fields.items()}
        made.append(
            built_effect(
                library, name, dict(values), places, ("effects", name), ("value",), found.torque_scale
            )
        )
        for key, entry in fields.items():
            _check_unit(entry.unit, library[name].parameters()[key].unit, places, ("effects", name, key))
            if isinstance(entry, FittedValue):
                if entry.uncertainty is not None:
                    uncertainties[f"{name}.{key}"] = entry.uncertainty
            elif entry.uncertainty is not None:
                for i, value in enumerate(entry.uncertainty):
                    if value is not None:
                        uncertainties[f"{name}.{key}[{i}]"] = value
    place = found.layout
    model = built_model(
        places,
        lambda: NeedleModel(
            found.name,
            Layout(
                m(place.needle_length_mm),
                tuple((m(a), m(b)) for a, b in place.tissue_sections_mm),
                tuple(m(x) for x in place.sensor_positions_mm),
                tuple((m(a), m(b), of) for a, b, of in place.segments),
                place.tip_clamped,
            ),
            found.base[TORSIONAL_RIGIDITY].value / NMM2_PER_NM2,
            per_length_n(found.base[FRICTION].value),
            tuple(made),
            torque_scale=found.torque_scale,
        ),
    )
    for number, correlation in enumerate(found.correlations):
        for name in correlation.of:
            if name not in uncertainties:
                raise places.error(
                    ("correlations", number, "of"),
                    f"{name} has no uncertainty here; take the entry out",
                )
    correlations = {entry.of: entry.value for entry in found.correlations}
    return SavedModel(model, found.starts_from, uncertainties, found.history, correlations)


def _check_unit(given: str, known: str, places: Places, path: DataPath) -> None:
    """Raises BadInput for a unit beside a value that is not the one in the value's name."""
    if given and key_endings(given) != key_endings(known):
        raise places.error(
            (*path, "unit"),
            f"{given} is not the unit of {path[-1]}: that is {known}; convert the value, or write {known}",
        )
