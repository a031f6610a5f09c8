"""The strategies on one's own model: the table, and how the shaft stands after each motion of a sequence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from needle_rig.control.strategy import make_strategy
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel
from needle_rig.units import deg, nmm, rad
from needle_rig.workbench.contest.strategies_table import Bout, all_strategies, compare_strategies
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.virtual.noise import NO_NOISE
from needle_rig.workbench.virtual.settled_run import SettledRun

PLACES = 60
"""Of the shaft that are drawn."""
TARGETS = 8
SEEDS = 10

Document = dict[str, Any]


def contest(
    saved: SavedModel, targets_deg: list[float], seeds: int, work: Work, say: Callable[[str], None]
) -> Document:
    """Every strategy on needles of this model. Raises BadInput, SolverError."""
    if not 1 <= len(targets_deg) <= TARGETS or not 1 <= seeds <= SEEDS:
        raise BadInput(f"give 1 to {TARGETS} targets and 1 to {SEEDS} runs of each kind")
    needle = saved.model
    bout = Bout(needle, needle.torsional_rigidity_nm2, saved=saved)
    names = all_strategies()
    say("running every strategy")
    table = compare_strategies(bout, names, targets_deg, seeds, work=work)
    say("planning the sequences to show")
    quiet = Bout(needle, needle.torsional_rigidity_nm2, NO_NOISE, saved)
    layout = needle.layout
    return {
        "rows": table.overall(),
        "target_deg": targets_deg[0],
        "needle_length_mm": layout.needle_length_m * 1e3,
        "tissue_sections_mm": [[a * 1e3, b * 1e3] for a, b in layout.tissue_sections_m],
        "hall_positions_mm": [place * 1e3 for place in layout.sensor_positions_m],
        "sequences": {name: told for name in names if (told := _sequence(quiet, name, targets_deg[0]))},
    }


def _sequence(bout: Bout, name: str, target_deg: float) -> Document | None:
    """One sequence on the model itself; None for a strategy that refuses it."""
    try:
        run = bout.run(make_strategy(name, {}), target_deg, "relaxed", 0)
    except BadInput:
        return None
    return {
        "motions": _motions(run),
        "left_deg": round(deg(run.worst_rad(rad(target_deg))), 2),
        "time_s": round(run.time_s, 1),
    }


def _motions(run: SettledRun) -> list[Document]:
    places_m = np.linspace(0.0, float(run.needles[-1].position_m[-1]), PLACES)
    return [
        {
            "name": motion.name or "rest",
            "time_s": round(motion.time_s, 2),
            "base_deg": round(deg(motion.base_angle_rad), 2),
            "torque_nmm": round(nmm(motion.torque_nm), 4),
            "places_mm": [round(float(p) * 1e3, 1) for p in places_m],
            "shaft_deg": [
                round(deg(float(a)), 2) for a in np.interp(places_m, needle.position_m, needle.angle_rad)
            ],
        }
        for motion, needle in zip(run.history, run.needles, strict=True)
    ]
