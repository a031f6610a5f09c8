"""Parameter sets: published numbers with their source, what they reproduce and what they do not."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable
from pathlib import Path

from needle_rig.config.check import validate
from needle_rig.config.file_kinds import as_read_here
from needle_rig.config.files import parameters_path
from needle_rig.config.places import read_yaml
from needle_rig.errors import BadInput
from needle_rig.model.build import built_effect, built_model, effect_directories
from needle_rig.model.files import SavedModel, saved_model
from needle_rig.model.schema import MODEL_FORMAT, PARAMETERS_FORMAT, ParameterSet
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import NMM2_PER_NM2, NeedleModel
from needle_rig.physics.rod import Layout
from needle_rig.units import per_length_n

EXPERIMENT_LAYOUT = Layout(
    needle_length_m=0.397,
    tissue_sections_m=((0.175, 0.200), (0.240, 0.265), (0.305, 0.330), (0.370, 0.395)),
    sensor_positions_m=(0.220, 0.285, 0.350, 0.396),
)
"""Reed, BioRob 2008, experiment: four sections of 25 mm, a sensor after each."""
MODEL_LAYOUT = Layout(
    needle_length_m=0.275, tissue_sections_m=((0.175, 0.275),), sensor_positions_m=(0.175, 0.275)
)
"""Reed, BioRob 2008, simulation: 175 mm free, 100 mm in tissue; seen at the entry and at the tip."""


def load_saved(name_or_path: str | os.PathLike[str], *, effects: Iterable[str | Path] = ()) -> SavedModel:
    """A parameter set, whose values have no uncertainty, or a model file with what it knows.

    Raises BadInput with file and line.
    """
    path = parameters_path(name_or_path)
    data, places = read_yaml(path)
    data = as_read_here(data, places, PARAMETERS_FORMAT, MODEL_FORMAT)
    if data["format"] == MODEL_FORMAT:
        return saved_model(data, places, effects)
    return SavedModel(load_parameters(path, effects=effects), path.stem)


def load_parameter_set(name_or_path: str | os.PathLike[str]) -> ParameterSet:
    """A parameter set as it stands on disk. Raises BadInput with file and line."""
    data, places = read_yaml(parameters_path(name_or_path))
    return validate(ParameterSet, data, places)


def load_parameters(
    name_or_path: str | os.PathLike[str],
    *,
    layout: Layout | None = None,
    effects: Iterable[str | Path] = (),
    element_length_m: float = 0.5e-3,
) -> NeedleModel:
    """The needle model of a parameter set or a model file.

    A set stands in the paper's experiment layout, a model file in its own, unless `layout` says otherwise.
    `effects` are further folders with users' effects. Raises BadInput with file and line.
    """
    path = parameters_path(name_or_path)
    data, places = read_yaml(path)
    data = as_read_here(data, places, PARAMETERS_FORMAT, MODEL_FORMAT)
    if data["format"] == MODEL_FORMAT:
        model = saved_model(data, places, effects).model
        return dataclasses.replace(model, layout=layout or model.layout, element_length_m=element_length_m)
    found = validate(ParameterSet, data, places)
    if found.solver != "rod" or found.friction_nmm_per_100mm is None:
        raise BadInput(
            f"{places.of(('solver',))}: {found.name} is for the solver {found.solver}"
            " (needle-rig reproduce runs it); choose another set for the rod"
        )
    library = find_effects(effect_directories(effects)) if found.effects else {}
    made = [
        built_effect(library, name, dict(v), places, ("effects", name)) for name, v in found.effects.items()
    ]
    return built_model(
        places,
        lambda: NeedleModel(
            found.name,
            layout or EXPERIMENT_LAYOUT,
            found.torsional_rigidity_nmm2 / NMM2_PER_NM2,
            per_length_n(found.friction_nmm_per_100mm or 0.0),
            tuple(made),
            element_length_m,
        ),
    )
