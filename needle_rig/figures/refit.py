"""Figures of the values of a refit: their correlations, and the profile of each."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import MaxNLocator

from needle_rig.config.hints import key_endings
from needle_rig.errors import BadInput
from needle_rig.figures.figure import Figure
from needle_rig.figures.style import COLOURS, COLUMN_IN, LETTERS_PT, PAGE_IN, above, plain
from needle_rig.physics.needle_model import FRICTION
from needle_rig.workbench.estimation.file_units import in_file_units, shared_units, within_bounds
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.parameters import shared_names
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.selection.answer import SIGMAS_95

MOST_ACROSS = 4
LINE_LETTERS = 22
DARK = 0.6
"""Correlation from which its number is white."""
PROFILE_SIGMAS = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)


def correlation(found: TraceComparison) -> Figure:
    """Correlation matrix of the values of the refit, but for those that were fixed."""
    of = found.baseline.current
    free = [i for i, value in enumerate(found.values.each) if value.refit_uncertainty is not None]
    size = np.sqrt(np.diag(of.covariance))[free]
    matrix = of.covariance[np.ix_(free, free)] / np.outer(size, size)
    names = [_broken(found.values.each[i].name, found.values.each[i].unit) for i in free]
    side = max(COLUMN_IN, 0.5 * len(free) + 1.9)
    figure = Figure(figsize=(side, side - 0.4), layout="constrained")
    axis = figure.subplots()
    image = axis.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    axis.set_xticks(range(len(free)), names, rotation=90)
    axis.set_yticks(range(len(free)), names)
    axis.tick_params(labelsize=LETTERS_PT)
    for (i, k), value in np.ndenumerate(matrix):
        axis.text(
            k,
            i,
            f"{value:.2f}".replace("-", "−"),
            ha="center",
            va="center",
            fontsize=LETTERS_PT,
            color="k" if abs(value) < DARK else "w",
        )
    bar = figure.colorbar(image, shrink=0.8)
    bar.set_label("correlation", fontsize=LETTERS_PT)
    bar.ax.tick_params(labelsize=LETTERS_PT)
    return figure


def _broken(name: str, unit: str) -> str:
    """A value's name, without its unit, in lines that a narrow figure has room for."""
    for ending in key_endings(unit):
        name = name.removesuffix(f"_{ending}")
    words = name.replace(".", "_").split("_")
    lines = [""]
    for word in words:
        if len(lines[-1]) + len(word) > LINE_LETTERS and lines[-1]:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(lines)


def profile(found: TraceComparison) -> Figure:
    """The objective with each value of the refit fixed in turn, all others fitted, beside a parabola.

    Where the two part, ± does not tell the interval. Friction has no profile: its ± is mostly the scatter of
    the trials' own, not a curve of the data.
    """
    problem, of = found.baseline.problem, found.baseline.current
    names, units = shared_names(of.parameters), shared_units(of.parameters)
    told_of = [(i, value) for i, value in enumerate(found.values.each) if value.name != FRICTION]
    free = [i for i, value in told_of if value.refit_uncertainty is not None]
    if not free:
        raise BadInput("figure profile: no value but friction was fitted; fix fewer of them")
    across = min(len(free), MOST_ACROSS)
    down = -(-len(free) // across)
    width = COLUMN_IN if across == 1 else PAGE_IN
    figure = Figure(figsize=(width, 2.5 * down), layout="constrained")
    grid = figure.subplots(down, across, squeeze=False, sharey=True).ravel()
    axes = grid[: len(free)]
    for empty in grid[len(free) :]:
        empty.set_visible(False)
    centre, size = of.vector.shared, np.sqrt(np.diag(of.covariance))
    for axis, i in zip(axes, free, strict=True):
        told = []
        for sigmas in PROFILE_SIGMAS:
            at = within_bounds(of.parameters, centre + sigmas * size[i] * np.eye(centre.size)[i])
            held = fit(problem.fixing({names[i]: float(at[i])}), of.effects, of.vector, nuisance=of.nuisance)
            if held is not None:
                told.append((in_file_units(of.parameters, at)[i], held.objective - of.objective, sigmas))
        value, risen, away = np.array(told).T
        axis.plot(value, risen, "o", ms=2.5, color=COLOURS[1], label="profile")
        smooth = np.linspace(away[0], away[-1], 61)
        axis.plot(np.interp(smooth, away, value), smooth**2, "--", lw=0.8, color="0.3", label="as ± tells")
        axis.axhline(SIGMAS_95**2, color="0.6", lw=0.6, ls=":", label="95 %")
        plain(axis)
        axis.set_xlabel(f"{_broken(names[i], units[i])} / {units[i]}", fontsize=LETTERS_PT)
        axis.xaxis.set_major_locator(MaxNLocator(3))
        axis.ticklabel_format(axis="x", useOffset=False)
    for axis in axes[::across]:
        axis.set_ylabel("−2 log posterior over its least", fontsize=LETTERS_PT)
    above(figure, axes[0])
    return figure
