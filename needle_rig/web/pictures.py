"""A model held against data for the page: its values beside those of a refit, figures of both, and the step
that takes the latter over.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.questions.compare import Compare
from needle_rig.questions.doing import Doing
from needle_rig.questions.identify import Identify
from needle_rig.web.models import kept_document
from needle_rig.workbench.learning.observations import Comparison

FORMATS = ("svg", "png", "pdf")
"""The first is shown, all can be saved."""

Document = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn(Compare):
    """One figure of a comparison."""

    what: str
    """Its name, as `loop` or `qq`."""


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


def figure(question: Drawn, doing: Doing, out: str) -> Document:
    """One figure of a comparison in every format, with its words. Raises BadInput, SolverError."""
    needed("matplotlib", "a figure", "figures")
    from needle_rig.figures.residuals import described, function, write_figure

    what = question.what
    function(what)
    found = question.answer(doing).traces()
    doing.say(f"drawing {what.replace('_', ' ')}")
    files = {kind: f"{what}.{kind}" for kind in FORMATS}
    for name in files.values():
        write_figure(found, Path(out) / name)
    return {"figure": what, "words": described(found, what), "files": files}


def take_values(question: Identify, doing: Doing, out: str) -> Document:
    """The model with the values that these data give, and the ladder of its errors.

    Raises BadInput, SolverError.
    """
    saved = question.saved()
    if saved is None:
        raise BadInput("there are no values to take over; choose a model with values, and data with traces")
    return kept_document(question.answer(doing).found.saved(saved, saved.model.name), out)
