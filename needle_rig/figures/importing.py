"""The picture of an import: every channel as it was understood, and torque over the base's angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg

from needle_rig.figures.figure import Figure
from needle_rig.numerics import Array

MOST_POINTS = 4000
"""More than pixels across; of longer channels every n-th sample is drawn."""


@dataclass(frozen=True)
class Drawn:
    """One channel: its title, its unit as shown, times in s and values in that unit, both (samples,)."""

    title: str
    unit: str
    time_s: Array
    values: Array


def draw_import(channels: Sequence[Drawn], loop: tuple[Array, Array] | None, path: Path) -> Path:
    """Write the picture: a row a channel over one time axis; `loop` is base angle and torque, each
    (samples,)."""
    rows = len(channels)
    figure = Figure(figsize=(10, 1.6 * rows + (3.2 if loop is not None else 0.4)), layout="constrained")
    FigureCanvasAgg(figure)
    ratios = [1.0] * rows + ([2.0] if loop is not None else [])
    all_axes = figure.subplots(len(ratios), 1, squeeze=False, height_ratios=ratios)[:, 0]
    for axes, channel in zip(all_axes, channels, strict=False):
        every = max(1, len(channel.values) // MOST_POINTS)
        axes.plot(channel.time_s[::every], channel.values[::every], color="C0", linewidth=0.8)
        axes.set_title(channel.title, fontsize=9, loc="left")
        axes.set_ylabel(channel.unit)
        axes.sharex(all_axes[0])
    all_axes[rows - 1].set_xlabel("time / s")
    if loop is not None:
        every = max(1, len(loop[0]) // MOST_POINTS)
        all_axes[-1].plot(loop[0][::every], loop[1][::every], color="C1", linewidth=0.8)
        all_axes[-1].set_title(
            "Torque over the base's angle: it rises with it, and goes round clockwise", fontsize=9, loc="left"
        )
        all_axes[-1].set_xlabel(f"{channels[0].title.split(' ')[0]} / {channels[0].unit}")
    figure.savefig(path, dpi=90)
    return path
