"""A model held against data for the page: its values beside those of a refit, figures of both, and the step
that takes the latter over.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.questions.compare import Compare
from needle_rig.questions.diagnose import Diagnose
from needle_rig.questions.doing import Doing
from needle_rig.questions.identify import Identify
from needle_rig.web.models import kept_document
from needle_rig.web.places import COMPARISON
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.learning.observations import Comparison

FORMATS = ("svg", "png", "pdf")
"""The first is shown, all can be saved."""

Document = dict[str, Any]


def values_of(found: Comparison) -> Document:
    """Each value of the model beside that of the refit, in numbers, and what is said of all of them."""
    told = found.as_json()
    stated = {name: value.get("pull_sigma") for name, value in told["free_parameters"].items()}
    each = found.values.sentences()
    return {
        "parameters": [{**value, "pull_sigma": stated.get(value["name"])} for value in told["parameters"]],
        "verdict_on_values": found.values.sentence(),
        "own": found.value_sentences()[len(each) :],
    }


def keep(found: Comparison, out: str) -> None:
    """Keep a comparison for its figures."""
    (Path(out) / COMPARISON).write_bytes(pickle.dumps(found, protocol=pickle.HIGHEST_PROTOCOL))


def figure(
    say: Callable[[str], None], *, comparison: str, what: str, again: Mapping[str, Any], out: str
) -> Document:
    """One figure of a comparison that was kept, in every format and as numbers, with its words.

    `again` is its question, for one that an earlier server kept. Raises BadInput, SolverError.
    """
    needed("matplotlib", "a figure", "figures")
    from needle_rig.figures.numbers import write_numbers
    from needle_rig.figures.residuals import described, drawn, function, write_figure

    function(what)
    found = _kept(say, comparison, again).traces()
    say(f"drawing {what.replace('_', ' ')}")
    files = {kind: f"{what}.{kind}" for kind in FORMATS}
    for name in files.values():
        write_figure(found, Path(out) / name)
    files["csv"] = f"{what}.csv"
    write_numbers(drawn(found, what), Path(out) / files["csv"])
    return {"figure": what, "words": described(found, what), "files": files}


def _kept(say: Callable[[str], None], comparison: str, again: Mapping[str, Any]) -> Comparison:
    """A comparison that was kept, or made again where an earlier server kept it."""
    place = Path(comparison)
    if not place.is_file():
        place.parent.mkdir(parents=True, exist_ok=True)
        keep(Compare.from_request(again).answer(Doing(say=say)), str(place.parent))
    kept: Comparison = pickle.loads(place.read_bytes())
    return kept


def report(
    say: Callable[[str], None],
    *,
    told: Mapping[str, Any],
    diagnosis: str,
    comparison: str,
    again: Mapping[str, Any],
    question: Mapping[str, Any],
    out: str,
) -> Document:
    """A diagnosis as one HTML file: `told` is what its job answered, `again` the question of its comparison.

    Raises BadInput, SolverError.
    """
    needed("matplotlib", "a report", "figures")
    from needle_rig.workbench.learning.diagnosis_file import load_diagnosis

    asked = Diagnose.from_request(question)
    compared = _kept(say, comparison, again)
    say("writing the report")
    kept = load_diagnosis(diagnosis, effects=asked.folders())
    file = Path(out) / "report.html"
    asked.write_report(told, kept, compared if isinstance(compared, TraceComparison) else None, file)
    return {"file": file.name}


def take_values(question: Identify, doing: Doing, out: str) -> Document:
    """The model with the values that these data give, and the ladder of its errors.

    Raises BadInput, SolverError.
    """
    saved = question.saved()
    if saved is None:
        raise BadInput("there are no values to take over; choose a model with values, and data with traces")
    return kept_document(question.answer(doing).found.saved(saved, saved.model.name), out)
