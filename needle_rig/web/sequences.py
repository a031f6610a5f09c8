"""The strategies on one's own model: the table, and how the shaft stands after each motion of a sequence."""

from __future__ import annotations

from typing import Any

import numpy as np

from needle_rig.control.strategy import make_strategy
from needle_rig.errors import BadInput
from needle_rig.questions.doing import Doing
from needle_rig.questions.strategies import Strategies
from needle_rig.units import deg, nmm, rad
from needle_rig.workbench.contest.strategies_table import Bout, all_strategies
from needle_rig.workbench.virtual.noise import NO_NOISE
from needle_rig.workbench.virtual.settled_run import SettledRun

PLACES = 60
"""Of the shaft that are drawn."""

Document = dict[str, Any]


def strategies(question: Strategies, doing: Doing, _out: str) -> Document:
    """The table, and the sequences to the first target as they go on the rig itself."""
    found, target_deg = question.answer(doing), question.targets_deg[0]
    needle = question.plant()
    doing.say("planning the sequences to show")
    quiet = Bout(needle, needle.torsional_rigidity_nm2, NO_NOISE, found.saved)
    layout = needle.layout
    return {
        "rows": found.table.overall(),
        "target_deg": target_deg,
        "needle_length_mm": layout.needle_length_m * 1e3,
        "tissue_sections_mm": [[a * 1e3, b * 1e3] for a, b in layout.tissue_sections_m],
        "hall_positions_mm": [place * 1e3 for place in layout.sensor_positions_m],
        "sequences": {
            name: told for name in all_strategies() if (told := _sequence(quiet, name, target_deg))
        },
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
