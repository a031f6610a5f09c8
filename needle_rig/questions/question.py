"""What all questions share: checked fields, and data, models and effects that are read in one place."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

from needle_rig.errors import BadInput
from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.fields import defaults, hints, taken

PathLike: TypeAlias = str | os.PathLike[str]
if TYPE_CHECKING:
    from needle_rig.dataset import Dataset
    from needle_rig.dataset.protocol import Protocol
    from needle_rig.dataset.settled import SettledData
    from needle_rig.model import SavedModel
    from needle_rig.physics.effect import Effect
    from needle_rig.physics.needle_model import NeedleModel
    from needle_rig.recording import RunFile
    from needle_rig.workbench.learning.observations import Observations

    AnyData: TypeAlias = PathLike | Sequence[PathLike] | Dataset | SettledData
    AnyModel: TypeAlias = PathLike | SavedModel
    AnyProtocol: TypeAlias = PathLike | Protocol
    AnyRun: TypeAlias = PathLike | RunFile
    Hidden: TypeAlias = str | Effect
else:  # looked at where they are read, so that a question imports light
    AnyData = AnyModel = AnyProtocol = AnyRun = Hidden = object

Kind = TypeVar("Kind", bound="Request")


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """Fields; making one raises BadInput for a field that holds something else than its type says."""

    def __post_init__(self) -> None:
        for name, hint in hints(type(self)).items():
            object.__setattr__(self, name, taken(name, hint, getattr(self, name)))

    @classmethod
    def from_request(cls: type[Kind], given: Mapping[str, Any]) -> Kind:
        """The question that a JSON object states. Raises BadInput for what it has too much or lacks."""
        known = hints(cls)
        for name in given:
            if name not in known:
                raise BadInput(f"{name[:60]}: is not asked here; give {', '.join(known)}")
        for name in known:
            if name not in given and name not in defaults(cls):
                raise BadInput(f"{name}: is missing; give it")
        return cls(**given)


@dataclass(frozen=True, slots=True, kw_only=True)
class Question(Request):
    """A request about models."""

    effects: Sequence[PathLike] = ()
    """Further folders with effects; config/effects is always searched."""

    def folders(self) -> list[str]:
        """Further folders with effects, as paths."""
        return [os.fspath(folder) for folder in self.effects]

    def library(self, doing: Doing) -> Mapping[str, type[Effect]]:
        """Effects by name; each broken file of one's own gets a warning. Raises BadInput."""
        from needle_rig.model import effect_directories
        from needle_rig.physics.library import find_effects

        found = find_effects(effect_directories(self.folders()))
        for _, sentence in found.broken:
            doing.tell(f"warning: {sentence}")
        return found

    def read_model(self, model: AnyModel | None) -> SavedModel | None:
        """A model file with what it knows, or a parameter set; None for the null model. Raises BadInput."""
        from needle_rig.model import SavedModel, load_saved

        if model is None or isinstance(model, SavedModel):
            return model
        if not isinstance(model, str | os.PathLike):
            raise BadInput(f"model is of type {type(model).__name__}; give a path, or a model")
        return load_saved(model, effects=self.folders())


@dataclass(frozen=True, slots=True, kw_only=True)
class OnSimulatedRig(Question):
    """A question that a simulated rig answers."""

    parameters: AnyModel = "rig_rigid"
    """The rig: parameter set, or model file."""
    hidden: Sequence[Hidden] = ()
    """Effects of the rig, as NAME=VALUE or as they are made."""

    def plant(self, doing: Doing = SILENT) -> NeedleModel:
        """The rig with its hidden effects. Raises BadInput."""
        from needle_rig.physics.effect_text import parse_effects

        saved = self.read_model(self.parameters)
        if saved is None:
            raise BadInput("parameters is None; name a parameter set or a model file")
        if not self.hidden:
            return saved.model
        named = parse_effects([one for one in self.hidden if isinstance(one, str)], self.library(doing))
        return saved.model.with_effects(*named, *(one for one in self.hidden if not isinstance(one, str)))


@dataclass(frozen=True, slots=True, kw_only=True)
class About(Question):
    """A question about measurements, and a model that may be held against them."""

    data: AnyData
    """Folders and names of datasets, run files, or what was read of them."""
    model: AnyModel | None = None
    """Model file, parameter set, or one that was read; None: the null model."""

    def observed(self) -> Observations:
        """Traces or settled values. Raises BadInput."""
        return read_observations(self.data)

    def traces(self, purpose: str) -> Dataset:
        """Traces alone, which `purpose` needs. Raises BadInput for settled values."""
        from needle_rig.workbench.learning.observations import Traces

        found = self.observed()
        if not isinstance(found, Traces):
            raise BadInput(
                f"{found.name}: holds settled values only, too few to {purpose}; name a dataset of traces or"
                " a run file"
            )
        return found.data

    def saved(self) -> SavedModel | None:
        """The model with what is known of it; None for the null model. Raises BadInput."""
        return self.read_model(self.model)


def read_observations(data: AnyData) -> Observations:
    """What was measured; run files count as read from here on. Raises BadInput."""
    from needle_rig.dataset import Dataset
    from needle_rig.dataset.settled import SettledData
    from needle_rig.recording import is_run_file, mark_read
    from needle_rig.workbench.learning.observations import observations
    from needle_rig.workbench.observations.sources import located, read_observed

    if isinstance(data, Dataset | SettledData):
        return observations(data)
    paths: Any = (data,) if isinstance(data, str | os.PathLike) else data
    if not isinstance(paths, Sequence) or not all(isinstance(p, str | os.PathLike) for p in paths):
        raise BadInput(f"data is of type {type(data).__name__}; give a path, or a dataset")
    read = observations(read_observed(paths))
    for path in located(paths):
        if is_run_file(str(path)):
            mark_read(path)
    return read
