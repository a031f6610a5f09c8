"""The strategies' table as one picture."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from needle_rig.figures.figure import Figure
from needle_rig.workbench.contest.strategies_table import Table


def strategies_figure(table: Table, title: str) -> Figure:
    """Worst error of every strategy with its runs, the straightest shaft first, and what it costs in time."""
    medians = {row["strategy"]: row["worst_deg"]["median"] for row in table.overall() if "worst_deg" in row}
    shown = sorted(medians, key=lambda name: medians[name])
    picture = Figure(figsize=(10.0, 1.6 + 0.42 * len(shown)), layout="constrained")
    left, right = picture.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    for place, name in enumerate(shown):
        results = table.chosen(name)
        worst = np.array([r.values["worst_deg"] for r in results])
        time = np.array([r.values["time_s"] for r in results])
        colour = "#0b6e4f" if name == "planned" else "#5b6770"
        jitter = place + 0.28 * (np.linspace(0, 1, len(worst)) - 0.5)
        left.plot(worst, jitter, ".", color=colour, alpha=0.35, markersize=4)
        left.plot([np.median(worst)] * 2, [place - 0.32, place + 0.32], color=colour, linewidth=2.5)
        right.barh(place, float(np.median(time)), color=colour, height=0.55)
        rotations = np.median([r.values["rotations"] for r in results])
        turns = "1 rotation" if rotations == 1 else f"{rotations:g} rotations"
        right.annotate(f" {turns}", (float(np.median(time)), place), va="center", fontsize=8)
    left.set_xscale("log")
    left.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    left.xaxis.set_major_formatter("{x:g}")
    left.xaxis.set_minor_formatter(NullFormatter())
    left.set_xlabel("worst angle error along the shaft / ° (line: median)")
    left.set_yticks(range(len(shown)), shown)
    left.invert_yaxis()
    left.grid(axis="x", alpha=0.3)
    right.set_xlabel("time / s")
    right.margins(x=0.35)
    picture.suptitle(title, fontsize=11)
    return picture
