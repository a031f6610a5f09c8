"""Breaks a rig in every way, at every place of a run; measures how far the base goes and if latches hold.

`hazards [--instants 20] [--pairs 2000] [--latches] [--slow] [--jobs 2] [--only NAME]`: production
control code, and the firmware's own C or a CiA 402 drive, in virtual time. Without any of `--instants`,
`--pairs`, `--latches` and `--slow` it does all four. Prints Markdown.
`--out FILE` keeps every trial as a JSON line; `--merge FILE...` makes the tables of such files;
`--repeat LINE` runs one trial with a trace.
Exit code 1 when a promise is broken, 2 when it cannot run.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from campaigns import ROOT
from campaigns.rig.hazard import plans
from campaigns.rig.hazard.campaign import AFTER_S, Found, Lame, broken, in_parallel, scout, until
from campaigns.rig.hazard.cases import Case
from campaigns.rig.hazard.faults import FAULTS
from campaigns.rig.hazard.plans import Plan
from campaigns.rig.hazard.tables import report
from campaigns.rig.hazard.trial import Trial
from needle_rig.units import deg

TRACE_MS = 20


def commit(evidence: bool) -> str:
    """This tree's commit, `+` where it is changed. Raises ValueError for evidence of a changed tree."""
    git = ("git", "-C", str(ROOT))
    name = subprocess.run(
        [*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True
    ).stdout.strip()
    dirty = subprocess.run([*git, "status", "--porcelain"], capture_output=True, text=True).stdout.strip()
    if evidence and (dirty or not name):
        raise ValueError("--evidence: the tree is changed, and evidence is of a commit; commit first")
    return (name or "no commit") + ("+" if dirty else "")


def repeat(text: str) -> int:
    """One trial, told every 20 ms. Raises ValueError for a line that is none."""
    case = Case.parse(text)
    scouted = scout(Plan(case.setup, case.scene, case.speed_deg_s, case.seed, ()))
    trial = until(case)
    start_s = trial.time_s
    trial.every_ms(TRACE_MS, lambda trial: trace(trial, start_s))
    result = broken(trial, case, max((scouted["end_s"] or 0.0) - trial.time_s, 0.0) + AFTER_S)
    why = case.broken(result)
    print(json.dumps(result.__dict__))
    print("; ".join(why) or "every promise is kept")
    return int(bool(why))


def trace(trial: Trial, start_s: float) -> None:
    """One line of what is true, and of what the host sees and says."""
    state, rig = trial.brain.state, trial.rig
    seen = state.measurement
    encoder_deg = deg(seen.base_angle_rad) if seen else 0.0
    print(
        f"{trial.time_s - start_s:7.3f} s  true {trial.true_deg:8.2f}°  encoder {encoder_deg:8.2f}°"
        f"  asked for {deg(state.velocity_rad_s):7.2f}°/s  {state.phase.value:9}"
        f"  {'awake' if rig.awake else '     '} {'running' if rig.running else '       '}"
        f"  {state.fault_name or ''}{' latched' if state.latched else ''}"
    )


def kept(lines: Iterable[str], file: Path | None) -> Iterator[str]:
    """`lines`, each written to `file` at once: a campaign that is cut off keeps what it has."""
    with open(file or os.devnull, "w", encoding="utf-8", buffering=1) as out:
        for line in lines:
            out.write(line)
            yield line


def planned(options: argparse.Namespace) -> list[Plan]:
    """Everything that was asked for."""
    everything = options.instants is options.pairs is None and not (options.latches or options.slow)
    found: list[Plan] = []
    if everything or options.instants:
        found += plans.singles(options.instants or 20, options.seed, options.only)
    if everything or options.pairs:
        found += plans.pairs(options.pairs or 2000, options.seed)
    if everything or options.latches:
        found += plans.latches(options.seed)
    if everything or options.slow:
        found += plans.slow(options.seed)
    return found


def main() -> int:
    """Run what is asked for and print its tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--instants", type=int, help="of every fault at every speed, for each drive (20)")
    parser.add_argument("--pairs", type=int, help="random pairs of faults (2000)")
    parser.add_argument("--latches", action="store_true", help="latching faults under passing ones")
    parser.add_argument("--slow", action="store_true", help="faults that show after a long time")
    parser.add_argument("--only", default="", help="single faults whose name holds this")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--evidence", action="store_true", help="refuse a tree that is changed")
    parser.add_argument("--out", type=Path, help="keep every trial as a JSON line")
    parser.add_argument("--merge", type=Path, nargs="+", help="make the tables of such files")
    parser.add_argument("--repeat", help="one trial, by the line that tells it")
    options = parser.parse_args()
    try:
        if options.repeat:
            return repeat(options.repeat)
        of_commit, start_s = commit(options.evidence), time.monotonic()
    except ValueError as error:
        parser.error(str(error))
    if not any(options.only in name for name in FAULTS):
        parser.error(f"no fault's name holds {options.only!r}")
    if options.merge:
        lines = [line for file in options.merge for line in file.read_text(encoding="utf-8").splitlines()]
    else:
        lines = list(kept(in_parallel(planned(options), options.jobs), options.out))
    found, lame = [], []
    for line in lines:
        told = json.loads(line)
        if "lame" in told:
            lame.append(Lame(**told["lame"]))
        else:
            found.append(Found.parse(line))
    if not found:
        parser.error("there is no trial in it; see --only, --instants, --pairs")
    cpu_s = sum(one.cpu_s for one in found)
    head = f"`hazards` at {of_commit}: {len(found)} trials, {cpu_s / 60.0:.1f} min of processor time"
    if not options.merge:
        head += f", {time.monotonic() - start_s:.0f} s"
    print(report(found, lame, head + f", seed {options.seed}."))
    return int(any(one.case.broken(one.result) for one in found))


if __name__ == "__main__":
    sys.exit(main())
