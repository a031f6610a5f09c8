"""The watch over the runs of a rig: which of its parameters have left the range of a reference period.

Every run that ended is identified alone, with play of the chuck and an offset of the torque in the model;
what was found is kept beside the runs, in `.watch`. A control chart for each parameter, and one for what the
model leaves, say what changed and since when; or that something did which the model cannot name.
"""

from __future__ import annotations

import dataclasses
import datetime
import fcntl
import hashlib
import json
import math
import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from needle_rig.config.schema import WatchSection
from needle_rig.dataset import Dataset
from needle_rig.dataset.samples import AT_REST_DEG
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.model import load_parameters, load_saved
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import BASE_PARAMETERS, NeedleModel
from needle_rig.recording import RunFile, journal_path
from needle_rig.recording.watch_summary import SUMMARY, WATCH_FOLDER
from needle_rig.records import JsonObject
from needle_rig.units import nm, rad
from needle_rig.workbench.estimation.baseline import null_model
from needle_rig.workbench.learning.control_chart import shift
from needle_rig.workbench.learning.identify import Identification, identify
from needle_rig.workbench.learning.last_run import contradiction
from needle_rig.workbench.learning.watched_runs import Watched, WatchedRun, kept_runs
from needle_rig.workbench.observations.earlier_path import after_earlier_runs
from needle_rig.workbench.observations.runs import BEGIN_S, runs_as_dataset

LOCK = "lock"
ADDED = ("chuck_backlash", "torque_bias")
"""What wears or drifts on any rig: free in every run beside the model's own parameters."""
JUDGED = ("aligned", "not_aligned")
"""How a run ends that went through."""
AT_REST_NMM = 0.01
"""Torque at the beginning of a run above which the shaft may be wound: a tenth of what friction holds."""
LEAST_RELATIVE = 0.02
"""Change of friction and of torsional rigidity that does not matter: what the latter is known to."""
LEAST_MISFIT = 0.1
"""The same of the logarithm of what the model leaves, and the least of that."""
TELL_EVERY_S = 5.0
"""While it looks at many runs."""
UNFINISHED = "its identification did not end: it took too long or too much memory"


@dataclass(frozen=True)
class Change:
    """One parameter that left its range."""

    parameter: str
    since_run: str
    since_utc: str
    runs: int
    """How many since then."""
    before: float
    after: float
    unit: str
    words: str
    impossible: bool = False
    """Every run since then wants it beyond its bound: it stands for something else."""


@dataclass(frozen=True)
class Watch:
    """What all runs of a rig say."""

    verdict: Literal["reference", "unchanged", "changed", "unknown"]
    """In the reference period, nothing changed, named, or something that these runs do not name."""
    changes: tuple[Change, ...]
    judged: int
    not_judged: int
    reference: int
    sentences: tuple[str, ...]
    contradiction: str = ""
    """What the newest run says against the model that is watched with; empty where it says nothing."""

    def as_json(self) -> JsonObject:
        """As it stands in the JSON answer and beside the runs."""
        return asdict(self)


def look(directory: Path, library: Mapping[str, type[Effect]], section: WatchSection | None = None) -> bool:
    """Identify the runs of `directory` that were not looked at yet, and keep what they say beside them.

    `section` (default: that of the rig file in each run) says with which model. False where another process
    looks already, or the folder cannot be written. Raises BadInput for a model that cannot be read.
    """
    with _alone(directory) as ours:
        if not ours:
            return False
        told_s = -math.inf
        while new := _new(directory):
            for path in new:
                # it may be ended before it is through: what the runs so far say stands then
                if time.monotonic() - told_s > TELL_EVERY_S:
                    _tell(directory, section)
                    told_s = time.monotonic()
                kept = directory / WATCH_FOLDER / f"{path.stem}.json"
                # a run on which the process dies is not tried again
                _write(kept, WatchedRun(run=path.stem, started_utc="", not_judged=UNFINISHED).model_dump())
                _write(kept, _look_at_file(path, library, section).model_dump())
        _tell(directory, section)
    return True


def _tell(directory: Path, section: WatchSection | None) -> None:
    """Write what all runs that were looked at say together."""
    _write(directory / WATCH_FOLDER / SUMMARY, said_of(directory, section).as_json())


def said_of(directory: Path, section: WatchSection | None = None) -> Watch:
    """What the runs that were looked at say together, and the newest of them against the watched model.

    `section` (default: that of the rig file in the newest run) says with which model.
    """
    runs = kept_runs(directory)
    section = section or section_of(directory, runs)
    found, said = judge(runs, section.reference_runs), ""
    if section.model is not None:
        with suppress(NeedleRigError):  # each run says why a model cannot be read
            said = contradiction(runs, load_saved(section.model), section.model)
    told = (*found.sentences, said) if said else found.sentences
    return dataclasses.replace(found, sentences=told, contradiction=said)


def restart(directory: Path) -> None:
    """Begin a new reference period with the next run: what was kept of the runs so far is put aside."""
    for run in kept_runs(directory):
        aside = run.model_copy(update={"parameters": {}, "not_judged": "before the reference period"})
        _write(directory / WATCH_FOLDER / f"{run.run}.json", aside.model_dump())
    (directory / WATCH_FOLDER / SUMMARY).unlink(missing_ok=True)


def section_of(directory: Path, runs: Sequence[WatchedRun]) -> WatchSection:
    """What the rig file in the newest run says of the watch."""
    for run in reversed(runs):
        with suppress(NeedleRigError):
            return RunFile(directory / f"{run.run}.h5").config.recording.watch or WatchSection()
    return WatchSection()


def judge(runs: Sequence[WatchedRun], reference: int) -> Watch:
    """What `runs`, in their order, say against the first `reference` of them that were judged.

    Of several rigs that of the newest run counts.
    """
    told = [run for run in runs if not run.not_judged]
    told = [run for run in told if run.rig == told[-1].rig]
    silent = len(runs) - len(told)
    aside = f" ({silent} runs are not judged: needle-rig watch --list)" if silent else ""
    if len(told) <= reference:
        said = f"reference period: {len(told)} of {reference} runs, nothing can be said yet{aside}"
        return Watch("reference", (), len(told), silent, reference, (said,))
    first = told[:reference]
    given = Counter(name for run in first for name in run.parameters)
    names = [name for name, times in given.items() if 2 * times >= reference]
    charts = len(names) + 1
    changes = [change for name in names if (change := _change(told, name, given[name], charts)) is not None]
    misfit = np.log([max(run.misfit, LEAST_MISFIT) for run in told])
    worse = shift(misfit, reference, LEAST_MISFIT, charts, both_ways=False)
    counts = len(told), silent, reference
    if worse is not None:
        why = f"the model leaves {math.exp(worse.after):.2f} × the noise, {math.exp(worse.before):.2f} before"
        return Watch("unknown", (), *counts, (_unknown(told[worse.since], why),))
    for change in changes:
        if change.impossible:
            why = f"{change.parameter} would lie beyond its bound of {change.after:g} {change.unit}"
            run = next(run for run in told if run.run == change.since_run)
            return Watch("unknown", (), *counts, (_unknown(run, why),))
    if not changes:
        since = f"{len(told) - reference} runs since {_day(told[reference].started_utc)}"
        said = f"nothing has changed: {since} against the {reference} of the reference period{aside}"
        return Watch("unchanged", (), *counts, (said,))
    sentences = [change.words for change in changes]
    grown = [math.log(c.after / c.before) for c in changes if c.parameter in BASE_PARAMETERS]
    if len(grown) == len(BASE_PARAMETERS) and np.ptp(grown) < LEAST_RELATIVE:
        sentences.append("a torque sensor whose gain has changed looks the same: check it with a weight")
    return Watch("changed", tuple(changes), *counts, tuple(sentences))


def _unknown(first: WatchedRun, why: str) -> str:
    return (
        f"something has changed since {_day(first.started_utc)} ({first.run}), these runs do not say what:"
        f" {why}; find out with: needle-rig diagnose {first.run}.h5 and the runs after it"
    )


def _change(told: Sequence[WatchedRun], name: str, reference: int, charts: int) -> Change | None:
    # a run in which the shaft slips little does not give its friction
    with_it = [run for run in told if name in run.parameters]
    seen = [run.parameters[name] for run in with_it]
    at = np.array([one.at for one in seen])
    found = shift(at, reference, max(one.least for one in seen[:reference]), charts)
    if found is None:
        return None
    first, since = with_it[found.since], len(seen) - found.since
    before = float(np.mean([one.value for one in seen[:reference]]))
    after = float(np.mean([one.value for one in seen[found.since :]]))
    when = f"since {_day(first.started_utc)} ({first.run}, {since} runs)"
    unit = seen[-1].unit
    if name in BASE_PARAMETERS:
        percent = 100.0 * math.expm1(found.after - found.before)
        words = f"{name} {abs(percent):.0f} % {'up' if percent > 0 else 'down'} {when}: {after:.4g} {unit}"
        words += f", {before:.4g} before"
    elif abs(found.before) < seen[-1].least <= abs(found.after):
        words = f"{name} of {after:.2g} {unit} has appeared {when}"
    else:
        way = "up" if after > before else "down"
        words = f"{name} {way} {when}: {after:.3g} {unit}, {before:.3g} before"
    seen_after = [one.at for one in seen[found.since :]]
    impossible = len({one.value for one in seen[found.since :]}) == 1 and len(set(seen_after)) > 1
    return Change(name, first.run, first.started_utc, since, before, after, unit, words, impossible)


def look_at(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    model: NeedleModel | None,
    run: str,
    started_utc: str,
) -> WatchedRun:
    """What one run says, by the model (default: the null model) with what wears or drifts on any rig.

    Raises BadInput, SolverError.
    """
    start = model or null_model(dataset)
    present = {effect.name() for effect in start.effects}
    found = identify(
        dataset, library, start.with_effects(*(library[name]() for name in ADDED if name not in present))
    )
    constants = dataset.needle.torsional_rigidity_nm2, dataset.needle.rigidity_sigma
    stated = [asdict(dataset.layout), constants, dataset.sensor_names, dataset.simulated]
    told = [*stated, model.values() if model else None]
    rig = hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()
    return WatchedRun(
        run=run, started_utc=started_utc, rig=rig, parameters=_watched(found), misfit=found.misfit
    )


def as_it_began(dataset: Dataset) -> Dataset:
    """The dataset of one run; a shaft on which nothing shows a twist when it begins is relaxed there."""
    (trial,) = dataset.trials
    first = trial.trial.time_s < trial.trial.time_s[0] + BEGIN_S
    angles_rad = np.column_stack([trial.trial.base_angle_rad, trial.hall_rad])[first]
    shown = [
        *(_mean(column) / rad(AT_REST_DEG) for column in angles_rad.T),
        _mean(trial.torque_nm[first]) / nm(AT_REST_NMM),
    ]
    if max(map(abs, shown)) > 1.0:
        return dataset
    return dataclasses.replace(dataset, trials=(dataclasses.replace(trial, start="relaxed"),))


def _mean(values: Array) -> float:
    """Mean of the numbers among `values` (n,); 0 where there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else 0.0


def _look_at_file(
    path: Path, library: Mapping[str, type[Effect]], section: WatchSection | None
) -> WatchedRun:
    """What one run says, or why it says nothing."""
    started_utc = ""
    try:
        run = RunFile(path)
        started_utc = str(run.attributes.get("started_utc", ""))
        status = (run.result or {}).get("status", "cut off")
        if status not in JUDGED:
            raise BadInput(f"ended as {status}")
        dataset = after_earlier_runs(as_it_began(runs_as_dataset([run], start="wound")), [run])
        stated = (section or run.config.recording.watch or WatchSection()).model
        model = load_parameters(stated, layout=dataset.layout) if stated else None
        return look_at(dataset, library, model, path.stem, started_utc)
    except (NeedleRigError, np.linalg.LinAlgError) as error:
        return WatchedRun(run=path.stem, started_utc=started_utc, not_judged=str(error))


def _watched(found: Identification) -> dict[str, Watched]:
    """The parameters that the run gives."""
    least = [LEAST_RELATIVE, LEAST_RELATIVE, *(parameter.smallest for parameter in found.parameters)]
    by_name = {estimate.name: estimate for estimate in found.estimates}
    watched = {}
    for name, at, size in zip(found.names, found.posterior.mean, least, strict=True):
        estimate = by_name[name]
        if estimate.value is not None and estimate.uncertainty is not None:
            watched[name] = Watched(
                at=float(at),
                value=estimate.value,
                uncertainty=estimate.uncertainty,
                unit=estimate.unit,
                least=size,
            )
    return watched


def _new(directory: Path) -> list[Path]:
    """Runs that ended and were not looked at, oldest first."""
    kept = {path.stem for path in (directory / WATCH_FOLDER).glob("*.json")}
    return sorted(p for p in directory.glob("*.h5") if p.stem not in kept and not journal_path(p).exists())


@contextmanager
def _alone(directory: Path) -> Iterator[bool]:
    """Whether this process alone looks at the runs of `directory`."""
    try:
        (directory / WATCH_FOLDER).mkdir(exist_ok=True)
        lock = os.open(directory / WATCH_FOLDER / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
    except OSError:
        yield False
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        yield False
    else:
        yield True
    finally:
        os.close(lock)


def _write(path: Path, content: JsonObject) -> None:
    """Whole or not at all."""
    new = path.with_suffix(".new")
    new.write_text(json.dumps(content, ensure_ascii=False), encoding="utf-8")
    new.replace(path)


def _day(time_utc: str) -> str:
    """The day of a time, or the text itself."""
    with suppress(ValueError):
        return datetime.datetime.fromisoformat(time_utc).date().isoformat()
    return time_utc or "an unknown day"
