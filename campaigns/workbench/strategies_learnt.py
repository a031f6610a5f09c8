"""What a law that no library holds costs a plan, and what a learnt one brings: planned beside reed2008.

Laws of `hidden_laws.py` are hidden in a simulated rig. Eight runs of it with reed2008 are all that is
learnt from; learn drafts the effect, adopt adds it, and planned works with that model, or with the null model
fitted to the same runs, on fresh needles of the rig. Where planned refuses the null model, for it misses the
runs by too much, it is run once more without being told by how much. Errors are of the true needle.
"""

from __future__ import annotations

import dataclasses
from argparse import Namespace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from campaigns.run import Campaign, Row, answered
from campaigns.workbench.hidden_laws import BY_NAME
from needle_rig.control.strategy import Reason, make_strategy
from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import load_protocol
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel, load_parameters
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.units import deg, rad
from needle_rig.workbench.contest.strategies_table import STARTS, Bout
from needle_rig.workbench.learning.learn_law import learn_law
from needle_rig.workbench.selection.explanation import IN_NOISE_UNITS
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise

RIGS: tuple[tuple[str, float], ...] = (
    ("slit", 2.0),
    ("encoder", 2.0),  # the library has it: encoder_eccentricity
    ("stop", 1.0),
    ("gear", 2.0),
    ("detent", 1.0),
    ("notch", 2.0),
    ("cell_cube", 2.0),
)
"""Laws and sizes: torques in the tissue, the drive, a reading that every sequence trusts."""
TARGETS_DEG = (30.0, 45.0, -60.0, 90.0)
SEEDS = 3
NOISE = Noise(friction_scatter=0.05)
REED, NULL, UNTOLD, LEARNT = WAYS = (
    "reed2008",
    "planned, null model",
    "planned, null model, its error not told",
    "planned, what was learnt",
)


def ended(bout: Bout, name: str) -> Row:
    """How runs of a strategy end, over targets, starts and needles."""
    worst, tip, gave_way, refused = [], [], 0, ""
    for target in TARGETS_DEG:
        for start in STARTS:
            for seed in range(SEEDS):
                try:
                    run = bout.run(make_strategy(name, {}), target, start, 9000 + seed)
                except BadInput as refusal:
                    refused = str(refusal)
                    continue
                worst.append(round(deg(run.worst_rad(rad(target))), 4))
                tip.append(round(abs(deg(run.tip_rad) - target), 4))
                gave_way += any(motion.reason is not Reason.STRATEGY for motion in run.history)
    return {"worst_deg": worst, "tip_deg": tip, "gave_way": gave_way, "refused": refused}


def hidden(law: str, size: float) -> tuple[NeedleModel, Dataset]:
    """The rig, and eight runs of it."""
    plant = load_parameters("rig_rigid").with_effects(BY_NAME[law].at(size))
    return plant, simulate_dataset(plant, load_protocol("standard"), 1, NOISE, name="runs")


def plan(_: Namespace) -> list[Row]:
    return [{"law": law, "size": size} for law, size in RIGS]


def ask(task: Row, _: Namespace) -> Row:
    """One rig: learnt from, and run."""
    plant, dataset = hidden(task["law"], task["size"])
    stated = dataset.needle.torsional_rigidity_nm2
    with TemporaryDirectory() as folder:
        lesson = learn_law(dataset, find_effects(), Path(folder) / "found.py")
        ran = {
            REED: ended(Bout(plant, stated, NOISE), "reed2008"),
            LEARNT: ended(Bout(plant, stated, NOISE, lesson.after), "planned"),
            **of_null(plant, dataset, lesson.before),
        }
    found = lesson.learnt
    return {
        "verdict": found.verdict,
        "laws": [each.law.name for each in found.laws],
        "formulas": [each.formula for each in found.laws],
        "library": list(found.library),
        "adopted": list(lesson.adopted),
        "before": lesson.before.history[-1].errors[IN_NOISE_UNITS].held_out_after,
        "after": lesson.after.history[-1].errors[IN_NOISE_UNITS].held_out_after,
        "runs": ran,
    }


def of_null(plant: NeedleModel, dataset: Dataset, null: SavedModel) -> dict[str, Row]:
    """Runs with the null model; where planned refuses it, also without its errors."""
    stated = dataset.needle.torsional_rigidity_nm2
    ran = {NULL: ended(Bout(plant, stated, NOISE, null), "planned")}
    if not ran[NULL]["worst_deg"]:
        untold = dataclasses.replace(null, history=())
        ran[UNTOLD] = ended(Bout(plant, stated, NOISE, untold), "planned")
    return ran


def table(every: list[Row], _: Namespace) -> str:
    """The figures, in Markdown."""
    rows = answered(every)
    count = len(TARGETS_DEG) * len(STARTS) * SEEDS
    targets = ", ".join(f"{t:g}°" for t in TARGETS_DEG)
    lines = [
        "Each rig hides one law of `campaigns/workbench/hidden_laws.py`. Medians (95 % quantiles) over"
        f" {count} runs each: targets {targets}, starts relaxed and wound, {SEEDS} needles. All ways meet the"
        " same needles.",
        "",
        "| hidden | learn says | error left out, × the noise | way | tip error ° | worst of the shaft ° |"
        " went on as reed2008 |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        told = ", ".join([*row["library"], *row["laws"]]) or "—"
        forms = "; ".join(f.partition(":")[0] for f in row["formulas"] if f)
        said = f"{row['verdict']}: {told}" + (f" ({forms})" if forms else "")
        step = f"{_number(row['before'])} → {_number(row['after'])}"
        for way in (w for w in WAYS if w in row["runs"]):
            ran = row["runs"][way]
            first = [f"{row['law']} × {row['size']:g}", said, step] if way == REED else ["", "", ""]
            lines.append("| " + " | ".join([*first, way, *_cells(ran)]) + " |")
    learnt = [r for r in rows if r["adopted"]]
    if learnt:
        lines += ["", _overall(learnt)]
    refused = sorted({r["runs"][w]["refused"] for r in rows for w in r["runs"]} - {""})
    lines += ["", *(f"- refused: {sentence}" for sentence in refused)] if refused else []
    return "\n".join(lines)


def _overall(rows: list[Row]) -> str:
    def middle(row: Row, way: str) -> float:
        return float(np.median(row["runs"][way]["worst_deg"]))

    ran = [r for r in rows if r["runs"][LEARNT]["worst_deg"]]
    times = [middle(r, REED) / middle(r, LEARNT) for r in ran]
    gains = [middle(r, UNTOLD if UNTOLD in r["runs"] else NULL) / middle(r, LEARNT) for r in ran]
    return (
        "With what was learnt the worst error of the shaft is smaller than reed2008's in"
        f" {sum(t > 1.0 for t in times)} of {len(rows)} rigs ({np.median(times):.1f} times in the median),"
        f" and than with the null model in {sum(g > 1.0 for g in gains)} ({np.median(gains):.1f} times)."
    )


def _cells(ran: Row) -> list[str]:
    if not ran["worst_deg"]:
        return ["refused", "refused", "—"]
    told = [
        f"{np.median(ran[key]):.1f} ({np.quantile(ran[key], 0.95):.1f})" for key in ("tip_deg", "worst_deg")
    ]
    return [*told, f"{ran['gave_way']} of {len(ran['worst_deg'])}"]


def _number(value: float | None) -> str:
    return "—" if value is None else f"{value:.2f}"


CAMPAIGN = Campaign(__doc__, plan, ask, table)
