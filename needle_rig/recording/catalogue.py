"""Which runs there are, and which one a person means."""

from __future__ import annotations

import difflib
import errno
import math
import os
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.recording.journal import SUFFIX, Frames, Journal, journal_path
from needle_rig.recording.liveness import being_written
from needle_rig.recording.reader import RunFile
from needle_rig.records import JsonObject

RUN = ".h5"


@dataclass(frozen=True)
class RunSummary:
    """One line of the list of runs."""

    name: str
    path: Path
    simulated: bool | None
    """Whether no real needle was turned; None for an unreadable run."""
    started_utc: str
    target_deg: float
    strategy: str
    parameters: str
    status: str
    """What the result says (aligned, not_aligned, aborted, fault), or: running, cut off, unreadable."""
    duration_s: float
    complete: bool
    tip_lag_deg: float = math.nan
    """How far the tip lags at the end."""


def list_runs(directory: str | os.PathLike[str]) -> list[RunSummary]:
    """The runs in `directory`, oldest first; unreadable files are listed too. An absent folder has none.

    Raises BadInput for one that is there and cannot be read.
    """
    return sorted(map(run_summary, runs_in(directory)), key=lambda run: (run.started_utc, run.name))


def runs_in(directory: str | os.PathLike[str]) -> set[Path]:
    """The run files in `directory`, those whose journal is not closed yet too; none in an absent folder.

    Raises BadInput for one that is there and cannot be read.
    """
    return {Path(directory) / f"{name}.h5" for name in changed_in(directory)}


def changed_in(directory: str | os.PathLike[str]) -> dict[str, tuple[int, int]]:
    """By name of a run in `directory`, when its file changed last (ns) and its size (bytes).

    Of a run without a file it is those of its journal. The folder is read once: one of 20,000 runs in a
    tenth of a second. Raises BadInput for a folder that is there and cannot be read.
    """
    found: dict[str, tuple[int, int]] = {}
    try:
        with os.scandir(directory) as entries:
            for entry in entries:
                name, _, ending = entry.name.rpartition(".")
                if not name or name.startswith(".") or f".{ending}" not in (RUN, SUFFIX):
                    continue
                if name in found and f".{ending}" == SUFFIX:
                    continue
                found[name] = _changed(entry)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise _unlistable(Path(directory), error) from None
    return found


def _changed(entry: os.DirEntry[str]) -> tuple[int, int]:
    try:
        state = entry.stat()
    except OSError:  # removed meanwhile, or a link to nothing
        return (0, 0)
    return state.st_mtime_ns, state.st_size


def _unlistable(directory: Path, error: OSError) -> BadInput:
    if error.errno != errno.ELOOP:
        return BadInput(f"{show_path(directory)}: cannot be listed ({error.strerror}); name a folder of runs")
    links = [place for place in (*reversed(directory.absolute().parents), directory) if place.is_symlink()]
    link = next((one for one in links if _loops(one)), directory)
    return BadInput(
        f"{show_path(link)}: this link leads to itself; remove it, or name another folder of runs"
    )


def _loops(link: Path) -> bool:
    try:
        link.stat()
    except OSError as error:
        return error.errno == errno.ELOOP
    return False


def unfinished_runs(directory: str | os.PathLike[str]) -> list[Path]:
    """The run files in `directory`, by name, whose writer was cut off before it could make them."""
    return [run for run in runs_in_journals(directory) if not being_written(run)]


def runs_in_journals(directory: str | os.PathLike[str]) -> list[Path]:
    """The run files in `directory`, by name, that are not made yet: being written, or cut off."""
    journals = sorted(one for one in Path(directory).glob(f"*{SUFFIX}") if one.is_file())
    return [journal.with_suffix(".h5") for journal in journals if not journal.name.startswith(".")]


def remove_empty_runs(directory: str | os.PathLike[str]) -> None:
    """Take away what starts that were given up left in `directory`: journals without a row."""
    for run in unfinished_runs(directory):
        journal = journal_path(run)
        with suppress(NeedleRigError, OSError):  # told where unfinished runs are closed
            if len(list(islice(Frames(journal), 2))) < 2:
                Journal.reopen(journal, lambda *_: None).remove()


def is_run_file(named: str) -> bool:
    """Whether `named` is a path at which a run lies, finished or not."""
    return os.path.isfile(named) or (named.endswith(".h5") and os.path.isfile(journal_path(Path(named))))


def find_run(named: str, directory: str | os.PathLike[str]) -> RunFile:
    """The run that `named` means: a path, a listed name, a part of one that fits no other, or `last`.

    Raises BadInput, naming what is there, when none or several fit.
    """
    if is_run_file(named):
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


def run_summary(path: Path) -> RunSummary:
    """What is listed of one run file."""
    try:
        run = RunFile(path)
        ending = run.ending()
    except BadInput:
        return RunSummary(path.stem, path, None, "", math.nan, "", "", "unreadable", 0.0, False)
    known: JsonObject = run.attributes
    first_s, last_s = ending.span_s
    if ending.result is not None:
        status = str(ending.result.get("status", "cut off"))
    else:
        status = "running" if being_written(path) else "cut off"
    return RunSummary(
        name=run.name,
        path=path,
        simulated=run.simulated,
        started_utc=str(known.get("started_utc", "")),
        target_deg=run.number("target_deg"),
        strategy=str(known.get("strategy", "")),
        parameters=str(known.get("parameters", "")),
        status=status,
        duration_s=0.0 if math.isnan(first_s) else last_s - first_s,
        complete=ending.complete,
        tip_lag_deg=_tip_lag_deg(ending.result),
    )


def _tip_lag_deg(result: JsonObject | None) -> float:
    """How far the tip lags at the end of a run; not a number where it is not known."""
    final = (result or {}).get("final")
    lag_deg = final.get("tip_lag_deg") if isinstance(final, dict) else None
    return float(lag_deg) if isinstance(lag_deg, int | float) else math.nan
