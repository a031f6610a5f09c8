"""A needle that is not ours, with Stribeck friction as textbooks write it: datasets of it, sequences on it.

textbook_needle sets --out DIR [--seeds 1,2,3]     the standard protocol, a folder a needle and seed
textbook_needle contest [--seeds N]                planned beside reed2008, each on the same needles

The needle is `tests/physics/textbook_needle.py`; drive, sensors, noise, scatter are ours. Needles are named
by `--ratio` υ_k/υ_s (1: nothing hidden), `--damping` in N·mm·s per 100 mm and `--exponent` (1 exponential, 2
Gaussian), each a list with commas.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
from pathlib import Path

import numpy as np

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


def contest(plain: TextbookNeedle, first_seed: int, seeds: int) -> str:
    """A row: medians (95 % quantiles) of the worst error of the shaft in °, and the rotations."""
    law = plain.friction
    falls = Stribeck(
        1.0 / law.kinetic_over_static - 1.0,
        rate_deg_s=deg(law.stribeck_rate_rad_s),
        weakening_deg=0.05,
        exponent=law.exponent,
    )
    cells, medians = [], []
    for model, name, options in (
        (NULL.with_effects(falls), "planned", {}),
        (NULL, "planned", {"use_hall": True}),
        (NULL, "planned", {}),
        (NULL, "reed2008", {}),
    ):
        bout = Bout(NULL, NULL.torsional_rigidity_nm2, saved=SavedModel(model, "textbook"))
        worst, rotations = [], []
        for target, start, seed in itertools.product((45.0, -90.0), ("relaxed", "wound"), range(seeds)):
            run = sequence(plain, bout, make_strategy(name, options), target, start, first_seed + seed)
            worst.append(deg(run.worst_rad(rad(target))))
            rotations.append(run.rotations)
        medians.append(float(np.median(worst)))
        cells.append(f"{medians[-1]:.2f} ({np.quantile(worst, 0.95):.2f}), {np.median(rotations):.0f}")
    ratios = ", ".join(f"{median / medians[-1]:.2f}" for median in medians[:-1])
    return " | ".join([*cells, ratios])


def numbers(text: str) -> list[float]:
    """Numbers with commas between them."""
    return [float(part) for part in text.split(",")]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("what", choices=("sets", "contest"))
    options.add_argument("--ratio", type=numbers, default=[0.5, 0.8])
    options.add_argument("--damping", type=numbers, default=[0.01])
    options.add_argument("--exponent", type=numbers, default=[1.0])
    options.add_argument("--seeds", type=numbers, default=[1.0])
    options.add_argument("--out", type=Path, default=Path())
    given = options.parse_args()
    for ratio, damping, exponent in itertools.product(given.ratio, given.damping, given.exponent):
        plain, name = rig(ratio, damping, exponent), f"ratio{ratio:g}_damping{damping:g}_exponent{exponent:g}"
        for seed in map(int, given.seeds):
            if given.what == "sets":
                made = dataset(plain, load_protocol("standard"), seed, Noise(), name)
                write_dataset(made, given.out / f"{name}_seed{seed}")
                print(given.out / f"{name}_seed{seed}", flush=True)
            else:
                law = f"{ratio:g} | {damping:g} | {exponent:g} | {seed}, {seed + 1}"
                print(f"| {law} | {contest(plain, seed, 2)} |", flush=True)


if __name__ == "__main__":
    main()
