"""Breaks a rig in every way, at every place of a run; measures how far the base goes and if latches hold.

Production control code, and the firmware's own C or a CiA 402 drive, in virtual time. A task is one healthy
sequence with the copies of it that are broken. `--where kind=pair` takes a part: single, pair, latch, slow.
`--only '{"trial": "LINE"}'` repeats a trial with a trace. Exit code 1 when a promise is broken.
"""

from __future__ import annotations

import argparse
import json
import sys
from argparse import Namespace
from dataclasses import asdict

from campaigns.rig.hazard import plans
from campaigns.rig.hazard.campaign import AFTER_S, Found, Lame, broken, results, scout, until
from campaigns.rig.hazard.cases import Case
from campaigns.rig.hazard.faults import FAULTS
from campaigns.rig.hazard.plans import Plan
from campaigns.rig.hazard.tables import report
from campaigns.rig.hazard.trial import Trial
from campaigns.run import Campaign, Row, answered
from needle_rig.units import deg

TRACE_MS = 20
PAIRS_AN_INSTANT = 100


def plan(given: Namespace) -> list[Row]:
    """Everything, the longest sequences first."""
    seed = given.first_seed
    kinds = {
        "single": plans.singles(given.size, seed, given.fault),
        "pair": plans.pairs(PAIRS_AN_INSTANT * given.size, seed),
        "latch": plans.latches(seed),
        "slow": plans.slow(seed),
    }
    every = [(kind, one) for kind, of_kind in kinds.items() for one in of_kind]
    return [{"kind": kind, **asdict(one)} for kind, one in sorted(every, key=lambda each: -each[1].trials)]


def ask(task: Row, _: Namespace) -> Row:
    """All trials of one sequence, each in a copy of this process; or one trial, with a trace."""
    if "trial" in task:
        return repeated(Case.parse(task["trial"]))
    places = tuple(
        (kind, place, tuple(tuple((name, at_s) for name, at_s in breaks) for breaks in many))
        for kind, place, many in task["places"]
    )
    found = list(results(Plan(task["setup"], task["scene"], task["speed_deg_s"], task["seed"], places)))
    return {
        "found": [one.line() for one in found if isinstance(one, Found)],
        "lame": [asdict(one) for one in found if isinstance(one, Lame)],
    }


def repeated(case: Case) -> Row:
    """One trial, told every 20 ms."""
    scouted = scout(Plan(case.setup, case.scene, case.speed_deg_s, case.seed, ()))
    trial = until(case)
    start_s = trial.time_s
    trial.every_ms(TRACE_MS, lambda trial: trace(trial, start_s))
    result = broken(trial, case, max((scouted["end_s"] or 0.0) - trial.time_s, 0.0) + AFTER_S)
    return {"result": asdict(result), "broken": case.broken(result)}


def trace(trial: Trial, start_s: float) -> None:
    """One line of what is true, and of what the host sees and says."""
    state, rig = trial.brain.state, trial.rig
    seen = state.measurement
    encoder_deg = deg(seen.base_angle_rad) if seen else 0.0
    print(
        f"{trial.time_s - start_s:7.3f} s  true {trial.true_deg:8.2f}°  encoder {encoder_deg:8.2f}°"
        f"  asked for {deg(state.velocity_rad_s):7.2f}°/s  {state.phase.value:9}"
        f"  {'awake' if rig.awake else '     '} {'running' if rig.running else '       '}"
        f"  {state.fault_name or ''}{' latched' if state.latched else ''}",
        file=sys.stderr,
    )


def trials(rows: list[Row]) -> list[Found]:
    return [Found.parse(line) for row in answered(rows) for line in row["found"]]


def table(rows: list[Row], _: Namespace) -> str:
    """The figures, and each trial that broke a promise."""
    found = trials(rows)
    lame = [Lame(**one) for row in answered(rows) for one in row["lame"]]
    return report(found, lame, f"{len(found)} trials.")


def failed(rows: list[Row]) -> bool:
    """Whether a trial broke a promise."""
    return any(one.case.broken(one.result) for one in trials(rows))


def fault(text: str) -> str:
    if not any(text in name for name in FAULTS):
        raise argparse.ArgumentTypeError(f"no fault's name holds {json.dumps(text)}")
    return text


def options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(first_seed=1)
    parser.add_argument("--fault", type=fault, default="", help="single faults whose name holds this")


SIZE = "instants of each fault, speed and drive (20)"
CAMPAIGN = Campaign(__doc__, plan, ask, table, 20, SIZE, options, failed)
