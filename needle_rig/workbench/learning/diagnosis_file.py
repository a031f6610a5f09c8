"""Diagnosis files: a diagnosis with its fits, so that they are taken over instead of made again.

format: needle-rig-diagnosis/1
checksum: of all that follows
program: version that wrote it
dataset: {name: mine, sha256: of what was measured}
started_from: "null"
verdict: effect
effects: [tissue_elasticity]
held_out_error: {before: 32.2, after: 0.98}
noise: {torque_nmm: 0.0008, hall_1_deg: 0.25}
policy: {evidence: {significance: 0.01, …}, …}
explanations:
  - added: [tissue_elasticity]
    improves_cross_validation: true
    trial_friction: [1.01, 0.99]
    model: a model file, with the values before and the errors as the last step of its history

The first explanation is of the named effects, the others tie with it.
"""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from needle_rig.config.check import validate
from needle_rig.config.places import DataPath, Places, read_yaml
from needle_rig.config.schema import Section
from needle_rig.model import HistoryEntry, SavedModel
from needle_rig.model.files import model_mapping, saved_model, write_whole
from needle_rig.records import JsonObject
from needle_rig.version import VERSION
from needle_rig.workbench.learning.observations import Observations
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.answer import Answer
from needle_rig.workbench.selection.explanation import Explanation

FORMAT = "needle-rig-diagnosis/1"

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Error = Annotated[float, Field(ge=0)]


class _Dataset(Section):
    name: str
    sha256: Sha256


class _HeldOutError(Section):
    before: Error | None
    after: Error | None


class _Explanation(Section):
    added: Annotated[tuple[str, ...], Field(min_length=1)]
    improves_cross_validation: bool
    trial_friction: tuple[Annotated[float, Field(gt=0)], ...]
    model: JsonObject


class _File(Section):
    format: Literal["needle-rig-diagnosis/1"]
    checksum: Sha256
    program: str
    dataset: _Dataset
    started_from: str
    verdict: Literal["effect", "none", "unknown"]
    effects: tuple[str, ...]
    held_out_error: _HeldOutError
    noise: dict[str, Error]
    policy: JsonObject
    explanations: tuple[_Explanation, ...]


@dataclass(frozen=True)
class KeptDiagnosis:
    """A diagnosis with what can be adopted from it."""

    dataset: str
    sha256: str
    started_from: str
    verdict: str
    effects: tuple[str, ...]
    held_out_error_before: float | None
    held_out_error_after: float | None
    noise: Mapping[str, float]
    policy: Mapping[str, object]
    explanations: tuple[Explanation, ...]
    models: tuple[SavedModel, ...]
    """What adopting each explanation gives."""
    place: str
    """The file, for errors."""

    @property
    def learnt(self) -> bool:
        """Whether the diagnosis began at a model that had learnt before, whose name is kept."""
        return any(len(model.history) > 1 for model in self.models)


def step(
    found: Explanation, dataset: str, saved: SavedModel | None, *, name: str, today: str | None = None
) -> SavedModel:
    """`saved` (default: the null model) with the effects of `found`, as one more step in its history."""
    entry = HistoryEntry(
        added=found.added,
        dataset=dataset,
        date=today or datetime.datetime.now(datetime.UTC).date().isoformat(),
        errors=dict(found.errors),
        values_before=dict(found.values_before),
        note="" if found.improves else "added by force: the error on commands left out did not fall",
    )
    return SavedModel(
        model=dataclasses.replace(found.model, name=name),
        starts_from=saved.starts_from if saved else "null",
        uncertainties=found.uncertainties,
        history=(*(saved.history if saved else ()), entry),
    )


def keep(answer: Answer, observed: Observations, saved: SavedModel | None = None) -> KeptDiagnosis:
    """A diagnosis of `observed` that began at `saved`, with its fits. Raises SolverError, BadInput."""
    found = answer.explanations()
    name = saved.model.name if saved else observed.name
    return KeptDiagnosis(
        dataset=observed.name,
        sha256=observed.sha256(),
        started_from=answer.model,
        verdict=answer.verdict,
        effects=answer.effects,
        held_out_error_before=answer.held_out_error_before,
        held_out_error_after=answer.held_out_error_after,
        noise=answer.noise,
        policy=POLICY.as_json(),
        explanations=found,
        models=tuple(step(f, observed.name, saved, name=name) for f in found),
        place=f"the diagnosis of {observed.name}",
    )


def save_diagnosis(path: str | os.PathLike[str], kept: KeptDiagnosis) -> None:
    """Write a diagnosis file, whole or not at all."""
    content = {
        "program": VERSION,
        "dataset": {"name": kept.dataset, "sha256": kept.sha256},
        "started_from": kept.started_from,
        "verdict": kept.verdict,
        "effects": list(kept.effects),
        "held_out_error": {
            "before": _known(kept.held_out_error_before),
            "after": _known(kept.held_out_error_after),
        },
        "noise": dict(kept.noise),
        "policy": dict(kept.policy),
        "explanations": [
            {
                "added": list(found.added),
                "improves_cross_validation": found.improves,
                "trial_friction": list(found.trial_friction),
                "model": model_mapping(model),
            }
            for found, model in zip(kept.explanations, kept.models, strict=True)
        ],
    }
    plain = json.loads(json.dumps(content))
    write_whole(path, {"format": FORMAT, "checksum": _checksum(plain), **plain})


def load_diagnosis(path: str | os.PathLike[str], *, effects: Iterable[str | Path] = ()) -> KeptDiagnosis:
    """A diagnosis file. Raises BadInput with file and line, also for one that was changed by hand."""
    data, places = read_yaml(path)
    read = validate(_File, data, places)
    folders = tuple(effects)
    models = []
    for k, part in enumerate(read.explanations):
        models.append(saved_model(part.model, _below(places, ("explanations", k, "model")), folders))
    stated = read.checksum
    del data["checksum"]
    if _checksum(data) != stated:
        raise places.error(
            ("checksum",),
            f"{stated[:8]}… is not that of what follows, {_checksum(data)[:8]}…: the file was changed after"
            " it was written; write it again with needle-rig diagnose --out",
        )
    found = []
    for k, (part, model) in enumerate(zip(read.explanations, models, strict=True)):
        last = model.history[-1] if model.history else None
        if last is None or last.added != part.added:
            raise places.error(
                ("explanations", k, "added"),
                "is not what the last step in the model's history added; write the file again with needle-rig"
                " diagnose --out",
            )
        found.append(
            Explanation(
                part.added,
                model.model,
                model.uncertainties,
                last.values_before,
                last.errors,
                part.improves_cross_validation,
                part.trial_friction,
            )
        )
    return KeptDiagnosis(
        read.dataset.name,
        read.dataset.sha256,
        read.started_from,
        read.verdict,
        read.effects,
        read.held_out_error.before,
        read.held_out_error.after,
        read.noise,
        read.policy,
        tuple(found),
        tuple(models),
        places.of(),
    )


def _known(error: float | None) -> float | None:
    return None if error is None or error != error or error == float("inf") else float(error)


def _checksum(content: Mapping[str, Any]) -> str:
    plain = {key: value for key, value in content.items() if key != "format"}
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def _below(places: Places, path: DataPath) -> Places:
    """The places of what stands at `path`, as if it were a file of its own."""

    def cut(found: Mapping[DataPath, Any]) -> dict[DataPath, Any]:
        return {key[len(path) :]: place for key, place in found.items() if key[: len(path)] == path}

    return Places(places.file, cut(places.keys), cut(places.values), cut(places.written))
