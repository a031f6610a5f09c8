"""A needle that is not ours, with Stribeck friction as textbooks write it: planned beside reed2008 on it.

The needle is `tests/physics/textbook_needle.py`; drive, sensors, noise, scatter are ours. A task names it by
`ratio` υ_k/υ_s (1: nothing hidden), `damping` in N·mm·s/rad per 100 mm and `exponent` (1 exponential, 2
Gaussian), and has two seeds. `--keep` writes datasets of the same needle and seeds, too, by the standard
protocol: `--only '{"ratio": 1, "damping": 0.01, "exponent": 1, "seed": 1}' --keep FOLDER`.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
from argparse import Namespace
from pathlib import Path

import numpy as np

from campaigns.run import Campaign, Row, answered, markdown
from campaigns.workbench.textbook_sets import NULL, dataset, rig, scattered
from needle_rig.control.strategy import Strategy, make_strategy
from needle_rig.dataset import write_dataset
from needle_rig.dataset.protocol import load_protocol
from needle_rig.model import SavedModel
from needle_rig.physics.effects.stribeck import Stribeck
from needle_rig.units import deg, rad
from needle_rig.workbench.contest.strategies_table import WOUND_DEG, Bout
from needle_rig.workbench.virtual.noise import Noise
from needle_rig.workbench.virtual.settled_run import RampDrive, SettledRun, carried_out
from tests.physics.textbook_needle import TextbookNeedle

RATIOS, DAMPINGS, EXPONENTS = (0.8, 0.5), (0.05, 0.01), (1.0, 2.0)
SEEDS = 2
"""Of a row."""
WAYS: dict[str, tuple[str, dict[str, bool], bool]] = {
    "planned, stribeck in the model": ("planned", {}, True),
    "planned, use_hall": ("planned", {"use_hall": True}, False),
    "planned": ("planned", {}, False),
    "reed2008": ("reed2008", {}, False),
}
"""Strategy, its options, and whether its model has the needle's law."""


def sequence(
    plain: TextbookNeedle, bout: Bout, chosen: Strategy, target_deg: float, start: str, seed: int
) -> SettledRun:
    """One sequence on the needle; `start` is relaxed or wound."""
    random = np.random.default_rng([seed, int(1000 * abs(target_deg)), start == "wound", 7])
    wound = rad(WOUND_DEG) * float(np.sign(target_deg)) if start == "wound" else 0.0
    one = dataclasses.replace(scattered(plain, random, bout.noise), base_rad=-wound)
    task = bout.task(target_deg)
    chosen.check(task)
    drive = RampDrive(wound, task.speed_rad_s, task.settle_s)
    return carried_out(chosen, task, drive, one, random, bout.noise)  # type: ignore[arg-type]


def plan(given: Namespace) -> list[Row]:
    seeds = range(given.first_seed, given.first_seed + SEEDS * given.size, SEEDS)
    fields, each = ("seed", "ratio", "damping", "exponent"), (seeds, RATIOS, DAMPINGS, EXPONENTS)
    return [dict(zip(fields, values, strict=True)) for values in itertools.product(*each)]


def ask(task: Row, given: Namespace) -> Row:
    """The worst error of the shaft (°) and the rotations of each sequence, by way of planning."""
    plain = rig(task["ratio"], task["damping"], task["exponent"])
    seeds = range(task["seed"], task["seed"] + SEEDS)
    if given.keep:
        for seed in seeds:
            name = f"ratio{task['ratio']:g}_damping{task['damping']:g}_exponent{task['exponent']:g}"
            made = dataset(plain, load_protocol("standard"), seed, Noise(), name)
            write_dataset(made, given.keep / f"{name}_seed{seed}")
    law = plain.friction
    falls = Stribeck(
        1.0 / law.kinetic_over_static - 1.0,
        rate_deg_s=deg(law.stribeck_rate_rad_s),
        weakening_deg=0.05,
        exponent=law.exponent,
    )
    found: dict[str, dict[str, list[float]]] = {}
    for title, (name, options, has_law) in WAYS.items():
        model = NULL.with_effects(falls) if has_law else NULL
        bout = Bout(NULL, NULL.torsional_rigidity_nm2, saved=SavedModel(model, "textbook"))
        of_way = found[title] = {"worst_deg": [], "rotations": []}
        for target, start, seed in itertools.product((45.0, -90.0), ("relaxed", "wound"), seeds):
            run = sequence(plain, bout, make_strategy(name, options), target, start, seed)
            of_way["worst_deg"].append(deg(run.worst_rad(rad(target))))
            of_way["rotations"].append(run.rotations)
    return {"ways": found}


def table(rows: list[Row], _: Namespace) -> str:
    """Medians (95 % quantiles) of the worst error of the shaft in °, and the rotations."""
    heads, lines = ["υ_k/υ_s", "damping", "δ", "first of two seeds"], []
    for row in answered(rows):
        cells = [row["ratio"], row["damping"], row["exponent"], row["seed"]]
        medians: list[float] = []
        for of_way in row["ways"].values():
            worst, rotations = of_way["worst_deg"], np.median(of_way["rotations"])
            medians.append(float(np.median(worst)))
            cells.append(f"{medians[-1]:.2f} ({np.quantile(worst, 0.95):.2f}), {rotations:.0f}")
        lines.append([*cells, ", ".join(f"{median / medians[-1]:.2f}" for median in medians[:-1])])
    return markdown([*heads, *WAYS, "ratios to reed2008"], lines)


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--keep", type=Path, help="folder for datasets of the task's needle and seeds")


CAMPAIGN = Campaign(__doc__, plan, ask, table, 2, "pairs of seeds of each needle (2)", options)
