"""The picture of a layout: how thick the shaft is, where tissue holds it, and where it is seen."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from needle_rig.figures.figure import Figure
from needle_rig.physics.rod import Layout
from needle_rig.units import mm

HALF_HEIGHT = 0.2
"""Of the needle in the picture; a segment's goes with the fourth root of its rigidity, as its diameter."""


def draw_layout(layout: Layout, sensor_names: Sequence[str], title: str, path: Path) -> Path:
    """Write the picture."""
    figure = Figure(figsize=(10, 2.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for number, (start, end) in enumerate(layout.tissue_sections_m):
        label = "friction of tissue, a guide or a sheath" if number == 0 else None
        axes.axvspan(mm(start), mm(end), color="C1", alpha=0.3, linewidth=0, label=label)
    edges = [0.0, layout.needle_length_m]
    edges = sorted({*edges, *(place for segment in layout.segments for place in segment[:2])})
    for start, end in pairwise(edges):
        middle = 0.5 * (start + end)
        relative = next((factor for a, b, factor in layout.segments if a < middle < b), 1.0)
        half = HALF_HEIGHT * relative**0.25
        axes.fill_between([mm(start), mm(end)], -half, half, color="0.6", edgecolor="0.3", linewidth=0.8)
        if relative != 1.0:
            axes.text(mm(middle), 0.0, f"{relative:.3g} ×", ha="center", va="center", fontsize=8)
    axes.plot([0.0, 0.0], [-0.9, 0.9], color="0.2", linewidth=4)
    axes.annotate("base", (0.0, -0.9), textcoords="offset points", xytext=(4, 2), fontsize=9)
    places = mm(np.array(layout.sensor_positions_m))
    axes.plot(places, np.full(len(places), 0.55), "v", color="C0")
    for number, (name, place) in enumerate(zip(sensor_names, places, strict=True)):
        axes.text(float(place), 0.68 + 0.16 * (number % 2), name, ha="center", fontsize=8)
    axes.set(ylim=(-1.0, 1.1), yticks=[], xlabel="distance from the base / mm", title=title)
    if layout.tissue_sections_m:
        axes.legend(loc="lower right", fontsize=8, frameon=False)
    figure.savefig(path, dpi=90)
    return path
