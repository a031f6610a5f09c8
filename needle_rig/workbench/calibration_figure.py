"""Pictures of a calibration: what is left after the fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from needle_rig.workbench.calibration import HallFit, LineFit

_BINS = 72


def draw_hall(fits: dict[str, HallFit], path: Path) -> Path:
    """Residual of every sensor over the turn: samples, and their mean every 5°."""
    figure = Figure(figsize=(8, 2 * len(fits) + 1), layout="constrained")
    FigureCanvasAgg(figure)
    all_axes = figure.subplots(len(fits), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, (name, fit) in zip(all_axes, fits.items(), strict=True):
        angle, residual = np.degrees(fit.angle_rad) % 360, np.degrees(fit.residual_rad)
        axes.plot(angle, residual, ".", markersize=1, alpha=0.3, color="0.6")
        bins = (angle / 360 * _BINS).astype(int) % _BINS
        present = np.unique(bins)
        means = [residual[bins == place].mean() for place in present]
        axes.plot((present + 0.5) * 360 / _BINS, means, color="C0", linewidth=1.5)
        axes.axhline(0, color="black", linewidth=0.5)
        axes.set_ylabel(f"{name}\nresidual °")
    all_axes[-1].set_xlabel("needle angle °")
    figure.suptitle("Hall sensors after calibration: samples, and their mean every 5°")
    figure.savefig(path, dpi=110)
    return path


def draw_line(fit: LineFit, path: Path, *, title: str, x: str, y: str) -> Path:
    """Residual of a straight line."""
    figure = Figure(figsize=(7, 3.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.plot(fit.x, fit.residual, "o", color="C0")
    axes.axhline(0, color="black", linewidth=0.5)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title)
    figure.savefig(path, dpi=110)
    return path
