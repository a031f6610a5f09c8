"""What the watch over the runs found, for the page: each parameter over the runs, its range, and alarms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from needle_rig.physics.library import find_effects
from needle_rig.web.models import finite
from needle_rig.workbench.learning import watch
from needle_rig.workbench.learning.watch import MISFIT
from needle_rig.workbench.learning.watched_runs import WatchedRun, kept_runs

LAG = "tip_lag_deg"
SHOWN = 500
"""Runs, the newest; ranges are those of all."""

Document = dict[str, Any]
NOTHING: Document = {
    "watched": False,
    "sentences": [],
    "alarm": False,
    "reference": 0,
    "judged": 0,
    "runs": [],
    "not_judged": [],
    "charts": [],
}
"""Where no run was looked at."""


def trends(directory: str, lags_deg: Mapping[str, float]) -> Document:
    """Every judged run of the newest rig, by parameter, with what the watch says of all of them.

    `lags_deg` is how far the tip lags at the end of a run, by run.
    """
    folder = Path(directory)
    runs = kept_runs(folder)
    if not runs:
        return NOTHING
    section = watch.section_of(folder, runs)
    found = watch.said_of(folder)
    judged = watch.of_one_rig(runs)
    told = judged[-SHOWN:]
    ranges = watch.limits(runs, section.reference_runs)
    since = {change.parameter: change.since_run for change in found.changes}
    names = list(dict.fromkeys(name for run in told for name in run.parameters))
    return {
        "watched": True,
        "sentences": list(found.sentences),
        "alarm": found.verdict in ("changed", "unknown") or bool(found.contradiction),
        "reference": section.reference_runs,
        "judged": found.judged,
        "runs": [{"run": run.run, "started_utc": run.started_utc} for run in told],
        "not_judged": [{"run": run.run, "why": run.not_judged} for run in runs if run.not_judged][-SHOWN:],
        "charts": [
            *(_chart(name, told, ranges, since) for name in (*names, MISFIT)),
            _lag_chart(told, lags_deg, [run.run for run in judged[: section.reference_runs]], bool(ranges)),
        ],
    }


def _lag_chart(
    told: list[WatchedRun], lags_deg: Mapping[str, float], first: list[str], over: bool
) -> Document:
    """The lag is no parameter: it is read, and the watch raises no alarm over it."""
    reference = [lags_deg[name] for name in first if name in lags_deg]
    return {
        "name": LAG,
        "unit": "°",
        "values": [lags_deg.get(run.run) for run in told],
        "uncertainties": [None for _ in told],
        "range": [finite(edge) for edge in watch.reference_range(reference)]
        if over and len(reference) > 1
        else None,
        "since": None,
    }


def _chart(
    name: str, told: list[WatchedRun], ranges: dict[str, tuple[float, float]], since: dict[str, str]
) -> Document:
    seen = [run.parameters.get(name) for run in told]
    values = [None if one is None else finite(one.value) for one in seen]
    unit = next((one.unit for one in seen if one is not None), "1")
    if name == MISFIT:
        values, unit = [finite(run.misfit) for run in told], "1"
    return {
        "name": name,
        "unit": unit,
        "values": values,
        "uncertainties": [None if one is None else finite(one.uncertainty) for one in seen],
        "range": None if name not in ranges else [finite(edge) for edge in ranges[name]],
        "since": since.get(name),
    }


def look(say: Callable[[str], None], *, directory: str, effects: list[str], out: str) -> Document:
    """Look at runs that are new: `{"looked": bool}`, false where another process does. Raises BadInput."""
    del out
    say("looking at the runs that were not looked at")
    ours = watch.look(Path(directory), find_effects([Path(folder) for folder in effects]))
    return {"looked": ours}
