"""How often something is said to be missing where nothing is, under each kind of noise.

Datasets have seeds of their own, in the five setups of `diagnosis_table`. On each the tests of what is left
over are made of the null model: the pattern of the residual, the pure-error F test and the error on commands
left out. On every tenth the search for effects is made too.
"""

from __future__ import annotations

from argparse import Namespace

import numpy as np

from campaigns.run import Campaign, Row, answered, markdown
from campaigns.workbench.diagnosis_sets import POOR, SETUPS, silent, simulated
from campaigns.workbench.noise_kinds import KINDS, noisy
from needle_rig.dataset import Dataset
from needle_rig.physics.library import find_effects
from needle_rig.units import deg
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.lack_of_fit import lack_of_fit
from needle_rig.workbench.selection.residual_patterns import find_residual_patterns

SEARCHED_EVERY = 10
SEED = 560_000


def made(kind: str, seed: int) -> Dataset:
    """Nothing hidden, in noise of this kind."""
    setup = SETUPS[seed % POOR]
    return noisy(simulated(silent(setup), (), SEED + seed), kind, setup.noise, SEED + seed)


def plan(given: Namespace) -> list[Row]:
    seeds = range(given.first_seed, given.first_seed + given.size)
    return [{"kind": kind, "seed": s, "whole": s % SEARCHED_EVERY == 0} for s in seeds for kind in KINDS]


def ask(task: Row, _: Namespace) -> Row:
    """What is said of one dataset."""
    data = made(task["kind"], task["seed"])
    if task["whole"]:
        found = diagnose(data, find_effects())
        baseline, left, lack = found.baseline, found.residual_patterns, found.lack_before
        said = {
            "verdict": found.verdict,
            "named": list(found.effects),
            "rules": [r.rule for r in found.reasons],
        }
    else:
        baseline, said = fit_baseline(data, None, find_effects()), {}
        left = find_residual_patterns(baseline.problem, baseline.current, data.sensor_names)
        lack = lack_of_fit(baseline.problem, baseline.current, data.sensor_names)
    noise = baseline.problem.noise
    return {
        "pattern": left.significant,
        "matters": any(not POLICY.size.small(p.size, p.unit) for p in left.patterns),
        "lack_p": None if lack is None else lack.p,
        "held_out": baseline.validation.error,
        "shown": [
            {"term": term.name, "form": float(term.form[0]), "most_deg": float(deg(np.max(term.sd[1:])))}
            for term in noise.shown
        ],
        **said,
    }


def table(every: list[Row], _: Namespace) -> str:
    """Rates a kind of noise, as Markdown."""
    rows, false_alarm = answered(every), POLICY.evidence.false_alarm
    limits = (1.1, POLICY.verdict.reached)
    head = [
        "noise",
        "sets",
        f"pattern, p < {false_alarm:g}",
        "of a size that matters",
        f"F test, p < {false_alarm:g}",
        *(f"left out > {limit:g}" for limit in limits),
        "left out, median, most",
        "searched: sets, named, unknown",
    ]
    lines = []
    for kind in KINDS:
        mine = [row for row in rows if row["kind"] == kind]
        if not mine:
            continue
        left_out = np.array([row["held_out"] for row in mine])
        lacks = [row["lack_p"] for row in mine if row["lack_p"] is not None]
        searched = [row for row in mine if row["whole"]]
        named = sum(row["verdict"] == "effect" for row in searched)
        unknown = sum(row["verdict"] == "unknown" for row in searched)
        cells = [
            kind,
            len(mine),
            sum(row["pattern"] for row in mine),
            sum(row["pattern"] and row["matters"] for row in mine),
            f"{sum(p < false_alarm for p in lacks)} of {len(lacks)}",
            *(int(np.sum(left_out > limit)) for limit in limits),
            f"{np.median(left_out):.2f}, {left_out.max():.2f}",
            f"{len(searched)}, {named}, {unknown}" if searched else "",
        ]
        lines.append(cells)
    return markdown(head, lines)


CAMPAIGN = Campaign(__doc__, plan, ask, table, size=200, counts="sets a kind of noise (200)")
