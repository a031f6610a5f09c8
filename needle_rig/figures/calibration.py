"""Pictures of a calibration: the residual of the fit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from needle_rig.figures.figure import Figure
from needle_rig.numerics import Array

_BINS = 72


def draw_hall(residuals: Mapping[str, tuple[Array, Array]], path: Path) -> Path:
    """Draw the residual of every sensor over the turn, samples and their mean every 5°; gives `path` back.

    `residuals` gives the needle's angle and the residual, both (samples,) in rad, by sensor.
    """
    figure = Figure(figsize=(8, 2 * len(residuals) + 1), layout="constrained")
    FigureCanvasAgg(figure)
    all_axes = figure.subplots(len(residuals), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, (name, (angle_rad, residual_rad)) in zip(all_axes, residuals.items(), strict=True):
        angle, residual = np.degrees(angle_rad) % 360, np.degrees(residual_rad)
        axes.plot(angle, residual, ".", markersize=1, alpha=0.3, color="0.6")
        bins = (angle / 360 * _BINS).astype(int) % _BINS
        present = np.unique(bins)
        means = [residual[bins == place].mean() for place in present]
        axes.plot((present + 0.5) * 360 / _BINS, means, color="C0", linewidth=1.5)
        axes.axhline(0, color="black", linewidth=0.5)
        axes.set_ylabel(f"{name}\nresidual / °")
    all_axes[-1].set_xlabel("needle angle / °")
    figure.suptitle("Hall sensors after calibration: samples, and their mean every 5°")
    figure.savefig(path, dpi=110)
    return path


def draw_line(x: Array, residual: Array, path: Path, *, title: str, x_label: str, y_label: str) -> Path:
    """Residual of a straight line over `x`, both (points,)."""
    figure = Figure(figsize=(7, 3.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.plot(x, residual, "o", color="C0")
    axes.axhline(0, color="black", linewidth=0.5)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.set_title(title)
    figure.savefig(path, dpi=110)
    return path
