"""What a worker does for the page's workbench: each kind of work from a request to a document.

Paths in requests are the server's own; a browser names keys. Results are written to the folder `out` of the
request, and the server gives them keys.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from needle_rig.dataset import write_dataset
from needle_rig.errors import BadInput, SolverError
from needle_rig.model import SavedModel, effect_directories, load_parameters, load_saved
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.recording import RunFile, mark_read
from needle_rig.recording.export_csv import export_csv
from needle_rig.recording.export_mcap import export_mcap
from needle_rig.web import laws, pictures, recordings, traces
from needle_rig.web.models import finite, kept_document
from needle_rig.web.places import DIAGNOSIS
from needle_rig.web.worker import Voice
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.learning.adopt import adopt_diagnosis
from needle_rig.workbench.learning.adopt import undo as take_back
from needle_rig.workbench.learning.compare import TraceComparison, compared, values_document
from needle_rig.workbench.learning.diagnosis_file import keep, load_diagnosis, save_diagnosis
from needle_rig.workbench.learning.observations import read_observations
from needle_rig.workbench.observations.runs import runs_as_dataset
from needle_rig.workbench.parallel import workers
from needle_rig.workbench.selection.diagnose import Diagnosis

Document = dict[str, Any]
CANDIDATES = 8
"""Of the ranking, whose fitted traces can be laid over the measured ones."""


def compare(
    voice: Voice, *, data: list[str], model: str | None, effects: list[str], held: Document, out: str
) -> Document:
    """Where a model fails: traces with the noise band, and every place of the residual map."""
    del out
    found = pictures.held_against(voice, data, model, effects, held)
    voice.step("drawing the traces")
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
    for t in traces.shown_trials(problem):
        trial = dataset.trials[t]
        drawn = traces.measured_document(dataset, trial, decimals)
        drawn["model"] = traces.model_document(problem, found.shown.fit, t, trial, decimals)
        drawn["refit"] = found.held and traces.model_document(problem, found.refit.fit, t, trial, decimals)
        trials.append(drawn)
    return {"channels": told, "trials": trials, "of": len(dataset.trials)}


def diagnose(
    voice: Voice, *, data: list[str], model: str | None, effects: list[str], out: str, jobs: int, quick: bool
) -> Document:
    """Which effect is missing: the ranking, ties and verdict, and the diagnosis file that `adopt` takes."""
    saved = load_saved(model, effects=effects) if model else None
    observed = read_observations(data)
    found = observed.diagnose(
        _library(effects),
        saved.model if saved else None,
        quick=quick,
        work=workers(jobs, None, voice.progress),
        say=voice.step,
    )
    voice.step("keeping the fits")
    save_diagnosis(Path(out) / DIAGNOSIS, keep(found, observed, saved))
    document: Document = {
        **{name: part for name, part in found.as_json().items() if name != "policy"},
        "sentence": found.sentence(),
        "errors_sentence": found.errors_sentence(),
        "ties": list(found.ties),
        "left_over": found.left_in_words(),
        "reasons": [reason.as_json() for reason in found.reasons],
        "quick": quick,
        "candidates": {},
    }
    if isinstance(found, Diagnosis):
        if saved is not None:
            held = compared(found.baseline, saved)
            document["model_values"] = values_document(held, structure_holds=found.verdict == "none")
        voice.step("drawing what each candidate predicts")
        document["candidates"] = _candidates(found)
    return document


def _candidates(found: Diagnosis) -> Document:
    """By effect: what its fit predicts for every drawn trial, by channel."""
    told = traces.channels_document(found.baseline.problem, found.baseline.dataset)
    decimals = [channel["digits"] for channel in told]
    drawn: Document = {}
    for row in found.ranking[:CANDIDATES]:
        fit = _fit_with(found, row.effect)
        if fit is None:
            continue
        try:
            drawn[row.effect] = [
                traces.model_document(
                    found.search.problem, fit, t, found.baseline.dataset.trials[t], decimals
                )
                for t in traces.shown_trials(found.baseline.problem)
            ]
        except SolverError:
            continue
    return drawn


def _fit_with(found: Diagnosis, effect: str) -> Fit | None:
    """The answer's fit for an effect that it names, else the best fit of fewest effects that has this one."""
    fits = {key: fit for key, (fit, _) in found.search.fits.items() if effect in key}
    if effect in found.effects:
        return fits.get(found.search.best)
    return min(fits.items(), key=lambda item: (len(item[0]), item[1].objective))[1] if fits else None


def adopt(
    voice: Voice, *, data: list[str], diagnosis: str, chosen: list[str], effects: list[str], out: str
) -> Document:
    """The model with what a diagnosis names, as it was fitted, and the ladder of its errors."""
    voice.step("holding the fit against the data")
    kept = load_diagnosis(diagnosis, effects=effects)
    observed = read_observations(data)
    saved = adopt_diagnosis(kept, observed, effects=chosen, name=None if kept.learnt else "learnt")
    return kept_document(saved, out)


def undo(voice: Voice, *, model: str, effects: list[str], out: str) -> Document:
    """The model before its last step; without a step left, none."""
    voice.step("taking the last step back")
    saved = load_saved(model, effects=effects)
    if len(saved.history) < 2:
        if saved.starts_from == "null":
            return {"model": None, "steps": [], "values": [], "added": []}
        raise BadInput(f"{saved.model.name}: has no step before this one; start again from the model file")
    return kept_document(take_back(saved), out)


def strategies(
    voice: Voice,
    *,
    model: str | None,
    parameters: str,
    targets_deg: list[float],
    seeds: int,
    effects: list[str],
    out: str,
    jobs: int,
) -> Document:
    """The strategies side by side on one simulated needle, and the sequence of each as a moving shaft."""
    del out
    from needle_rig.web.sequences import contest

    if model is None:
        saved = SavedModel(load_parameters(parameters, effects=effects), parameters)
    else:
        saved = load_saved(model, effects=effects)
    return contest(saved, targets_deg, seeds, workers(jobs, None, voice.progress), voice.step)


def show(voice: Voice, *, data: list[str], out: str) -> Document:
    """Recorded runs as traces, one beside the other, without a model."""
    del out
    voice.step("reading the runs")
    shown = []
    for path in data:
        file = RunFile(path)
        dataset = runs_as_dataset([file])
        trial = dataset.trials[0]
        decimals = [4, *(2 for _ in dataset.sensor_names)]
        shown.append(
            {"run": file.name, "result": file.result} | traces.measured_document(dataset, trial, decimals)
        )
    return {"runs": shown}


def export(voice: Voice, *, data: list[str], form: str, out: str) -> Document:
    """A run as a file of another format; folders come packed."""
    voice.step("writing the file")
    run, folder = RunFile(data[0]), Path(out)
    if form == "csv":
        export_csv(run, folder / f"{run.name}_csv")
        written = packed(folder / f"{run.name}_csv")
    elif form == "dataset":
        written = packed(write_dataset(runs_as_dataset([run]), folder / f"{run.name}_dataset"))
    elif form == "mcap":
        written = export_mcap(run, folder / f"{run.name}.mcap")
    elif form == "png":
        from needle_rig.figures.run import draw_run

        written = draw_run(run, folder / f"{run.name}.png")
    else:
        raise BadInput(f"{form[:20]}: no such format; there are csv, dataset, mcap, png")
    mark_read(run.path)
    return {"file": written.name}


def packed(folder: Path) -> Path:
    """The folder as a ZIP beside it."""
    return Path(shutil.make_archive(str(folder), "zip", folder.parent, folder.name))


KINDS: Mapping[str, Callable[..., Document]] = {
    "guess": recordings.guess,
    "import": recordings.imported,
    "learn": laws.learn,
    "adopt_law": laws.adopt_law,
    "compare": compare,
    "figure": pictures.figure,
    "take_values": pictures.take_values,
    "diagnose": diagnose,
    "adopt": adopt,
    "undo": undo,
    "strategies": strategies,
    "show": show,
    "export": export,
}


def _library(effects: list[str]) -> Mapping[str, type[Effect]]:
    return find_effects(effect_directories(tuple(effects)))
