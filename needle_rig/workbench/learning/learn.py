"""From a rig's own runs to a model of it: simulate or take a dataset, diagnose, adopt what is found."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from needle_rig.dataset import Dataset
from needle_rig.model import HistoryEntry, SavedModel
from needle_rig.physics.effect import Effect
from needle_rig.workbench.estimation.baseline import Baseline, fit_baseline
from needle_rig.workbench.learning.adopt import Refused, adopt, adopt_diagnosis
from needle_rig.workbench.learning.diagnosis_file import keep
from needle_rig.workbench.learning.observations import Traces
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.explanation import errors_by_channel, uncertainties


@dataclass(frozen=True)
class Lesson:
    """What runs taught: the model before (nothing added) and after."""

    before: SavedModel
    after: SavedModel
    verdict: str
    """Of the diagnosis between them, or of `learn`."""
    adopted: tuple[str, ...]


def learn(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    *,
    max_effects: int = 3,
    work: Work | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Lesson:
    """Diagnose `dataset` from the null model and adopt the effects that are named, together.

    Of effects that tie, the first is taken. What improves no cross-validation is left out, as `adopt` refuses
    it. Raises BadInput, SolverError.
    """
    found = diagnose(dataset, library, max_effects=max_effects, work=work, say=say)
    before = saved_fit(found.baseline)
    if not found.effects:
        return Lesson(before, before, found.verdict, ())
    say(f"adopting {' and '.join(found.effects)}")
    try:
        after = adopt_diagnosis(keep(found, Traces(dataset)), effects=found.effects)
    except Refused as refusal:
        say(str(refusal))
        return Lesson(before, before, found.verdict, ())
    return Lesson(before, after, found.verdict, after.history[-1].added)


def fit_known(dataset: Dataset, library: Mapping[str, type[Effect]], effects: Sequence[str]) -> SavedModel:
    """A model with the named effects, fitted to `dataset` one after the other, without looking for others."""
    if not effects:
        return saved_fit(fit_baseline(dataset, None, library))
    saved = None
    for effect in effects:
        saved = adopt(Traces(dataset), effect, library, saved, force=True, name=dataset.name)
    assert saved is not None
    return saved


def saved_fit(baseline: Baseline) -> SavedModel:
    """The model of a baseline, fitted as it is, with its errors as history."""
    current = baseline.current
    entry = HistoryEntry(
        dataset=baseline.dataset.name,
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        errors=errors_by_channel(baseline, current, baseline.validation),
        note="fitted as it is",
    )
    model = baseline.problem.model(current.parameters, current.vector)
    return SavedModel(model, "null", uncertainties(current), (entry,))
