"""Parameter sets and model files: YAML on disk ↔ needle models.

A parameter set is published: numbers with their source, what they reproduce and what they do not. A model
file is learnt: the set it started from, effects with fitted values and uncertainties, and its history.
"""

from needle_rig.config.files import parameter_sets, parameters_path
from needle_rig.model.build import effect_directories
from needle_rig.model.files import SavedModel, load_model, model_in, save_model
from needle_rig.model.schema import ChannelErrors, HistoryEntry, ParameterSet
from needle_rig.model.sets import (
    EXPERIMENT_LAYOUT,
    MODEL_LAYOUT,
    load_parameter_set,
    load_parameters,
    load_saved,
)

__all__ = [
    "EXPERIMENT_LAYOUT",
    "MODEL_LAYOUT",
    "ChannelErrors",
    "HistoryEntry",
    "ParameterSet",
    "SavedModel",
    "effect_directories",
    "load_model",
    "load_parameter_set",
    "load_parameters",
    "load_saved",
    "model_in",
    "parameter_sets",
    "parameters_path",
    "save_model",
]
