"""What a worker does for the page's workbench: a question's answer, or a file, as a document.

Paths in requests are the server's own; a browser names keys. Results are written to the folder `out` of the
request, and the server gives them keys.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from needle_rig.errors import SolverError
from needle_rig.extras import needed
from needle_rig.model import load_saved
from needle_rig.questions.adopt import AddEffect, Adopt, Undo
from needle_rig.questions.compare import Compare
from needle_rig.questions.diagnose import Diagnose
from needle_rig.questions.doing import Doing
from needle_rig.questions.export import Export, Form
from needle_rig.questions.identify import Identify
from needle_rig.questions.learn import Learn
from needle_rig.questions.question import Question
from needle_rig.questions.simulate import Simulate
from needle_rig.questions.strategies import Strategies
from needle_rig.recording import RunFile
from needle_rig.web import pictures, recordings, traces
from needle_rig.web.laws import learn
from needle_rig.web.models import finite, kept_document
from needle_rig.web.places import DATASET, DIAGNOSIS
from needle_rig.web.sequences import strategies
from needle_rig.web.trends import look
from needle_rig.workbench.estimation.problem import Fit
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.observations.runs import runs_as_dataset
from needle_rig.workbench.selection.diagnose import Diagnosis

Document = dict[str, Any]
Say = Callable[[str], None]
EVENTS = 1000
"""Of a run, shown."""
CANDIDATES = 8
"""Of the ranking, whose fitted traces can be laid over the measured ones."""


def work(kind: str, request: Document, doing: Doing) -> Document:
    """The document that a job of this kind gives; `out` of the request is its folder. Raises BadInput."""
    if kind in FILES:
        return FILES[kind](doing.say, **request)
    asked, view = QUESTIONS[kind]
    out = str(request.pop("out"))
    return view(asked.from_request(request), doing, out)


def compare(question: Compare, doing: Doing, out: str) -> Document:
    """Where a model fails: traces with the noise band, and every place of the residual map."""
    found = question.answer(doing)
    pictures.keep(found, out)
    doing.say("drawing the traces")
    headings, rows = found.rows()
    document: Document = {
        "name": found.headline()[0],
        "sentence": found.headline()[1],
        "headings": headings,
        "rows": rows,
        "sentences": found.sentences(),
        "places": found.places(),
        "values": found.value_sentences(),
        **pictures.values_of(found),
        "held_out_error": finite(found.held_out_error),
        "traces": None,
    }
    if isinstance(found, TraceComparison):
        document["traces"] = _traces(found)
        document["sentences"] = [p.words for p in found.shown.worst]
        document["notes"] = list(found.notes)
    return document


def _traces(found: TraceComparison) -> Document:
    problem, dataset = found.baseline.problem, found.baseline.dataset
    told = traces.channels_document(problem, dataset)
    decimals = [channel["digits"] for channel in told]
    trials = []
    for t in found.worst_trials()[: traces.TRIALS]:
        trial = dataset.trials[t]
        drawn = traces.measured_document(dataset, trial, decimals)
        drawn["model"] = traces.model_document(problem, found.shown.fit, t, trial, decimals)
        drawn["refit"] = found.held and traces.model_document(problem, found.refit.fit, t, trial, decimals)
        trials.append(drawn)
    return {"channels": told, "trials": trials, "of": len(dataset.trials)}


def diagnose(question: Diagnose, doing: Doing, out: str) -> Document:
    """Which effect is missing: the ranking, ties and verdict, and the diagnosis file that `adopt` takes."""
    answer = question.answer(doing)
    doing.say("keeping the fits")
    answer.save(Path(out) / DIAGNOSIS)
    found = answer.found
    document: Document = {
        **answer.told(),
        "quick": question.quick,
        "candidates": {},
    }
    compared = answer.compared()
    if isinstance(found, Diagnosis) and compared is not None:
        doing.say("drawing what each candidate predicts")
        document["candidates"] = _candidates(found, compared)
    return document


def _candidates(found: Diagnosis, compared: TraceComparison) -> Document:
    """By effect and file: what its fit predicts for every drawn trial, by channel."""
    told = traces.channels_document(found.baseline.problem, found.baseline.dataset)
    decimals = [channel["digits"] for channel in told]
    trials = {t: found.baseline.dataset.trials[t] for t in compared.worst_trials()[: traces.TRIALS]}
    drawn: Document = {}
    for row in found.ranking[:CANDIDATES]:
        fit = _fit_with(found, row.effect)
        if fit is None:
            continue
        try:
            drawn[row.effect] = {
                trial.file: traces.model_document(found.search.problem, fit, t, trial, decimals)
                for t, trial in trials.items()
            }
        except SolverError:
            continue
    return drawn


def _fit_with(found: Diagnosis, effect: str) -> Fit | None:
    """The answer's fit for an effect that it names, else the best fit of fewest effects that has this one."""
    fits = {key: fit for key, (fit, _) in found.search.fits.items() if effect in key}
    if effect in found.effects:
        return fits.get(found.search.best)
    return min(fits.items(), key=lambda item: (len(item[0]), item[1].objective))[1] if fits else None


def adopt(question: Adopt | AddEffect, doing: Doing, out: str) -> Document:
    """The model with what it learnt, and the ladder of its errors."""
    return kept_document(question.answer(doing), out)


def opened(say: Say, *, model: str, effects: list[str], out: str) -> Document:
    """Values and ladder of errors of a model file that a person dropped. Raises BadInput."""
    say("reading the model")
    return kept_document(load_saved(model, effects=effects), out)


def undo(question: Undo, doing: Doing, out: str) -> Document:
    """The model before its last step; the null model is none."""
    saved = question.answer(doing)
    if not saved.history and saved.starts_from == "null":
        return {"model": None, "steps": [], "values": [], "added": []}
    return kept_document(saved, out)


def show(say: Say, *, data: list[str], out: str) -> Document:
    """Recorded runs as traces, one beside the other, without a model."""
    del out
    say("reading the runs")
    shown = []
    for path in data:
        file = RunFile(path)
        dataset = runs_as_dataset([file])
        trial = dataset.trials[0]
        decimals = [4, *(2 for _ in dataset.sensor_names)]
        shown.append(
            {"run": file.name, "result": file.result, **_about(file)}
            | traces.measured_document(dataset, trial, decimals)
        )
    return {"runs": shown}


def _about(file: RunFile) -> Document:
    """What was ordered, with what, and what happened when."""
    known = file.attributes
    # times of events are those of the rows, which are told from the beginning of the sequence
    begin_s = next((event.time_s for event in file.events if event.kind == "phase"), 0.0)
    told = {"rig": "rig", "needle": "parameters", "strategy": "strategy", "model": "model"}
    numbers = {"target / °": "target_deg", "settling time / s": "settle_s", "speed / °/s": "speed_deg_s"}
    settings = {word: str(known[name]) for word, name in told.items() if known.get(name)}
    settings |= {
        word: f"{value:g}" for word, name in numbers.items() if math.isfinite(value := file.number(name))
    }
    options = _mapping(known.get("options"))
    settings |= {name.replace("_", " "): json.dumps(value) for name, value in options.items()}
    versions = _mapping(known.get("versions"))
    settings |= {"recorded by": f"needle-rig {versions['needle-rig']}"} if "needle-rig" in versions else {}
    events = [
        {"time_s": finite(round(event.time_s - begin_s, 2)), "kind": event.kind, "text": event.text}
        for event in file.events[:EVENTS]
    ]
    return {"settings": settings, "events": events}


def _mapping(text: object) -> Document:
    """A JSON object in an attribute; empty for anything else, as a foreign file may hold."""
    with suppress(ValueError, RecursionError):
        found = json.loads(str(text))
        if isinstance(found, dict):
            return found
    return {}


def export(say: Say, *, data: list[str], form: Form, out: str) -> Document:
    """A run as a file of another format; folders come packed."""
    written = Export(run=data[0], form=form, folder=out).answer(Doing(say=say))
    if written.is_dir():
        written = Path(shutil.make_archive(str(written), "zip", written.parent, written.name))
    return {"file": written.name}


def example(question: Simulate, doing: Doing, out: str) -> Document:
    """A simulated series for those without data."""
    return {"name": replace(question, out=Path(out) / DATASET).answer(doing).name}


def chart(say: Say, *, chart: Document, out: str) -> Document:
    """A chart of the page, drawn for print as SVG; `chart` was checked by `asked.Chart`. Raises BadInput."""
    needed("matplotlib", "a chart as SVG", "figures")
    from needle_rig.figures.chart import Line, values, write_chart

    say("drawing the chart")
    shared = chart["shared"]
    along = None if shared is None else values(shared)
    lines = [
        Line(told["label"], told["look"], values(one[0]) if along is None else along, values(one[-1]))
        for told, one in zip(chart["series"], chart["each"], strict=True)
    ]
    bands = [(upper - 1, lower - 1) for upper, lower in chart["bands"]]
    axes = (chart["x"], chart["y"])
    path = write_chart(Path(out) / "chart.svg", chart["title"], axes, lines, bands, chart["level"])
    return {"file": path.name}


QUESTIONS: Mapping[str, tuple[type[Question], Callable[..., Document]]] = {
    "compare": (Compare, compare),
    "diagnose": (Diagnose, diagnose),
    "take_values": (Identify, pictures.take_values),
    "adopt": (Adopt, adopt),
    "add_effect": (AddEffect, adopt),
    "undo": (Undo, undo),
    "learn": (Learn, learn),
    "strategies": (Strategies, strategies),
    "example": (Simulate, example),
}
FILES: Mapping[str, Callable[..., Document]] = {
    "guess": recordings.guess,
    "import": recordings.imported,
    "figure": pictures.figure,
    "report": pictures.report,
    "chart": chart,
    "open": opened,
    "show": show,
    "export": export,
    "watch": look,
}
