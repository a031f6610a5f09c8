"""From a rig's own runs to a model of it: simulate or take a dataset, diagnose, adopt what is found."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from needle_rig.dataset import Dataset
from needle_rig.model import HistoryEntry, SavedModel
from needle_rig.physics.effect import Effect
from needle_rig.workbench.estimation.baseline import Prepared, prepare
from needle_rig.workbench.learning.adopt import Refused, adopt, ladder_errors, uncertainties
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.selection.diagnose import Diagnosis, diagnose


@dataclass(frozen=True)
class Lesson:
    """What runs taught: the model before (nothing added) and after, and the diagnosis between."""

    before: SavedModel
    after: SavedModel
    diagnosis: Diagnosis
    adopted: tuple[str, ...]


def learn(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    *,
    max_effects: int = 3,
    work: Work | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Lesson:
    """Diagnose `dataset` from the null model and adopt the effects that are named, strongest first.

    An effect that foretells no better is left out, as `adopt` refuses it. Raises BadInput, SolverError.
    """
    found = diagnose(dataset, library, max_effects=max_effects, work=work, say=say)
    before = fitted(found)
    saved, adopted = None, []
    for effect in found.effects:
        say(f"adopting {effect}")
        try:
            saved = adopt(dataset, effect, library, saved, name=dataset.name)
        except Refused as refusal:
            say(str(refusal))
            continue
        adopted.append(effect)
    return Lesson(before, saved or before, found, tuple(adopted))


def fit_known(dataset: Dataset, library: Mapping[str, type[Effect]], effects: Sequence[str]) -> SavedModel:
    """A model with the named effects, fitted to `dataset` one after the other, without looking for others."""
    if not effects:
        return _saved(prepare(dataset, None, library))
    saved = None
    for effect in effects:
        saved = adopt(dataset, effect, library, saved, force=True, name=dataset.name)
    assert saved is not None
    return saved


def fitted(found: Diagnosis) -> SavedModel:
    """The present model of a diagnosis, fitted to its dataset, with its errors as history."""
    return _saved(found.prepared)


def _saved(prepared: Prepared) -> SavedModel:
    present = prepared.present
    entry = HistoryEntry(
        dataset=prepared.dataset.name,
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        errors=ladder_errors(prepared, present, prepared.held),
        note="fitted as it is",
    )
    model = prepared.problem.model(present.axes, present.point)
    return SavedModel(model, "null", uncertainties(present), (entry,))
