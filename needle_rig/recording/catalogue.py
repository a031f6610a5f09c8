"""Which runs there are, and which one a person means."""

from __future__ import annotations

import difflib
import math
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput
from needle_rig.recording.reader import RunFile

LIVE_S = 2.0
"""A file without an end that changed within this time is still being written."""


@dataclass(frozen=True)
class RunSummary:
    """One line of the list of runs."""

    name: str
    path: Path
    started_utc: str
    target_deg: float
    strategy: str
    parameters: str
    status: str
    """What the result says (aligned, not_aligned, aborted, fault), or: running, cut off, unreadable."""
    duration_s: float
    complete: bool


def list_runs(directory: str | os.PathLike[str]) -> list[RunSummary]:
    """The runs in `directory`, oldest first; unreadable files are listed too. An absent folder has none."""
    paths = [path for path in Path(directory).glob("*.h5") if not path.name.startswith(".")]
    return sorted((_summary(path) for path in paths), key=lambda run: (run.started_utc, run.name))


def find_run(named: str, directory: str | os.PathLike[str]) -> RunFile:
    """The run that `named` means: a path, a listed name, a part of one that fits no other, or `last`.

    Raises BadInput, naming what is there, when none or several fit.
    """
    if os.path.isfile(named):
        return RunFile(named)
    shown = show_path(directory)
    names = [run.name for run in list_runs(directory) if run.status != "unreadable"]
    if not names:
        raise BadInput(f"{named}: no run in {shown}; make one with: needle-rig compensate --target 45")
    if named == "last":
        return RunFile(Path(directory) / f"{names[-1]}.h5")
    stem = named.removesuffix(".h5")
    fitting = [stem] if stem in names else [name for name in names if stem in name]
    if len(fitting) == 1:
        return RunFile(Path(directory) / f"{fitting[0]}.h5")
    if fitting:
        raise BadInput(f"{named}: fits {len(fitting)} runs in {shown}: {', '.join(fitting[:4])}; say which")
    close = difflib.get_close_matches(stem, names, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]}?" if close else f"the last one is {names[-1]}"
    raise BadInput(f"{named}: no such run in {shown}; {hint}")


def _summary(path: Path) -> RunSummary:
    try:
        run = RunFile(path)
        ending = run.ending()
    except BadInput:
        return RunSummary(path.stem, path, "", math.nan, "", "", "unreadable", 0.0, False)
    known: dict[str, Any] = run.attributes
    first_s, last_s = ending.span_s
    if ending.complete:
        status = str((ending.result or {}).get("status", "no result"))
    else:
        status = "running" if time.time() - path.stat().st_mtime < LIVE_S else "cut off"
    return RunSummary(
        name=run.name,
        path=path,
        started_utc=str(known.get("started_utc", "")),
        target_deg=float(known.get("target_deg", math.nan)),
        strategy=str(known.get("strategy", "")),
        parameters=str(known.get("parameters", "")),
        status=status,
        duration_s=0.0 if math.isnan(first_s) else last_s - first_s,
        complete=ending.complete,
    )
