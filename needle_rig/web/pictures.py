"""A model held against data for the page: its values beside those of a refit, figures of both, and the step
that takes the latter over.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.model import effect_directories, load_saved
from needle_rig.physics.library import find_effects
from needle_rig.web.models import kept_document
from needle_rig.web.worker import Voice
from needle_rig.workbench.learning.compare import Held
from needle_rig.workbench.learning.identify import identify
from needle_rig.workbench.learning.observations import Comparison, Traces, read_observations

FORMATS = ("svg", "png", "pdf")
"""The first is shown, all can be saved."""

Document = dict[str, Any]


def held_against(
    voice: Voice, data: list[str], model: str | None, effects: list[str], held: Document
) -> Comparison:
    """The comparison that a request asks for. Raises BadInput, SolverError."""
    voice.step("holding the model against the data, and fitting it")
    library = find_effects(effect_directories(tuple(effects)))
    saved = load_saved(model, effects=effects) if model else None
    return read_observations(data).compare(library, saved, Held(**held))


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


def figure(
    voice: Voice,
    *,
    data: list[str],
    model: str | None,
    effects: list[str],
    held: Document,
    what: str,
    out: str,
) -> Document:
    """One figure of a comparison in every format, with its words. Raises BadInput, SolverError."""
    needed("matplotlib", "a figure", "figures")
    from needle_rig.figures.residuals import described, function, write_figure

    function(what)
    found = held_against(voice, data, model, effects, held).traces()
    voice.step(f"drawing {what.replace('_', ' ')}")
    files = {kind: f"{what}.{kind}" for kind in FORMATS}
    for name in files.values():
        write_figure(found, Path(out) / name)
    return {"figure": what, "words": described(found, what), "files": files}


def take_values(
    voice: Voice, *, data: list[str], model: str | None, effects: list[str], out: str
) -> Document:
    """The model with the values that these data give, and the ladder of its errors.

    Raises BadInput, SolverError.
    """
    observed = read_observations(data)
    if model is None or not isinstance(observed, Traces):
        raise BadInput("there are no values to take over; choose a model with values, and data with traces")
    voice.step("fitting the values")
    saved = load_saved(model, effects=effects)
    found = identify(observed.data, find_effects(effect_directories(tuple(effects))), saved.model)
    return kept_document(found.saved(saved, saved.model.name), out)
