"""A law that no library holds, learnt for the page: its curve, its formula, and its effect file, adopted.

The effect file is written by this program from what was learnt; no upload adds Python.
"""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

from needle_rig.errors import BadInput
from needle_rig.model import effect_directories, load_saved
from needle_rig.numerics import Array
from needle_rig.physics.library import find_effects
from needle_rig.web.models import finite, kept_document
from needle_rig.web.worker import Voice
from needle_rig.workbench.laws.draft import Origin
from needle_rig.workbench.laws.learn import learn_laws
from needle_rig.workbench.laws.learnt import LearntLaw
from needle_rig.workbench.learning.adopt import adopt
from needle_rig.workbench.learning.observations import Traces, read_observations
from needle_rig.workbench.parallel import workers

Document = dict[str, Any]


def learn(
    voice: Voice, *, data: list[str], model: str | None, effects: list[str], draft: str, out: str, jobs: int
) -> Document:
    """Which law is missing: the verdict in words, and each law with its curve.

    The effect files are drafted in `out`, the first by the name `draft`. Raises BadInput, SolverError.
    """
    observed = read_observations(data)
    if not isinstance(observed, Traces):
        raise BadInput(f"{observed.name}: holds settled values only, from which no curve can be learnt")
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    found = learn_laws(
        observed.data,
        find_effects(effect_directories(tuple(effects))),
        load_saved(model, effects=effects).model if model else None,
        origin=Origin(observed.name, observed.sha256(), today),
        workers=lambda: workers(jobs, None, voice.progress),
        say=voice.step,
    )
    drafts = found.write_drafts(Path(out) / draft) if found.laws else ()
    return {
        "verdict": found.verdict,
        "sentence": found.sentence,
        "library": list(found.library),
        "tried": found.tried,
        "held_out_before": finite(found.held_out_before),
        "held_out_after": finite(found.held_out_after),
        "laws": [_law(law) for law in found.laws],
        "files": [file.name for file in drafts],
    }


def adopt_law(
    voice: Voice, *, data: list[str], model: str | None, effects: list[str], drafts: str, law: str, out: str
) -> Document:
    """The model with the effect `law` of the folder `drafts`, refitted, and the ladder of its errors."""
    voice.step("fitting the model with the law")
    folders = [*effects, drafts]
    saved = load_saved(model, effects=folders) if model else None
    library = find_effects(effect_directories(tuple(folders)))
    adopted = adopt(read_observations(data), law, library, saved, name=None if saved else "learnt")
    return kept_document(adopted, out)


def _law(law: LearntLaw) -> Document:
    curve = law.curve
    return {
        "name": law.law.name,
        "words": law.law.words(),
        "tied_with": [other.words() for other in law.tied_with],
        "experiment": None if law.experiment is None else law.experiment["sentence"],
        "held_out_before": finite(law.held_out_before),
        "held_out_after": finite(law.held_out_after),
        "formula": law.formula,
        "parameters": [
            {"name": name, "value": finite(value), "uncertainty": finite(spread), "unit": of}
            for name, value, spread, of in law.parameters
        ],
        "unit": law.law.unit,
        "variable": law.law.variable,
        "variable_unit": law.law.variable_unit,
        "at": _numbers(curve.at),
        "value": _numbers(curve.value),
        "low": _numbers(curve.low),
        "high": _numbers(curve.high),
        "data": _numbers(curve.data),
        "halves": [_numbers(half) for half in curve.halves],
    }


def _numbers(values: Array) -> list[float | None]:
    return [finite(float(v)) for v in values]
