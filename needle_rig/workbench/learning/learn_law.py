"""From a rig's own runs to a model with a law that no library holds: learn it, draft its file, adopt it."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from needle_rig.dataset import Dataset
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import load_effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.laws.draft import Origin
from needle_rig.workbench.laws.learn_laws import learn_laws
from needle_rig.workbench.laws.learnt import Learnt
from needle_rig.workbench.learning.adopt import Refused, adopt
from needle_rig.workbench.learning.learn import Lesson, saved_fit
from needle_rig.workbench.learning.observations import Traces
from needle_rig.workbench.parallel import Work


@dataclass(frozen=True)
class LawLesson(Lesson):
    """What runs taught where laws were looked for, too."""

    learnt: Learnt
    library: Mapping[str, type[Effect]]
    """Effects, the drafted ones among them."""


def laws_of(
    observed: Traces,
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None = None,
    *,
    work: Work | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Learnt:
    """Learn laws from traces; what is drafted says which data and day it comes from.

    Raises BadInput, SolverError.
    """
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    origin = Origin(observed.name, observed.sha256(), today)
    return learn_laws(observed.data, library, model, origin=origin, work=work, say=say)


def learn_law(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    draft: Path,
    *,
    work: Work | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> LawLesson:
    """Learn laws from `dataset`, draft effect files at `draft` (.py) and adopt them one after the other.

    What the library holds is adopted in their place, or first. Nothing is adopted where the verdict is
    `cannot_tell` or `none`, nor what improves no cross-validation. Raises BadInput, SolverError.
    """
    observed = Traces(dataset)
    found = laws_of(observed, library, work=work, say=say)
    before = saved_fit(found.baseline)
    if found.verdict not in ("law", "library"):
        return LawLesson(before, before, found.verdict, (), found, library)
    drafts = {path.stem: load_effect(path) for path in found.write_drafts(draft)}
    known, saved, adopted = {**library, **drafts}, None, []
    for name in (*found.library, *drafts):
        say(f"adopting {name}")
        try:
            saved = adopt(observed, name, known, saved, name=dataset.name)
        except Refused as refusal:
            say(str(refusal))
            continue
        adopted.append(name)
    return LawLesson(before, saved or before, found.verdict, tuple(adopted), found, known)
