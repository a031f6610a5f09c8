"""Figures of the values of a refit: their correlations, and the profile of each."""

from __future__ import annotations

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.figures.figure import Figure
from needle_rig.physics.needle_model import FRICTION
from needle_rig.workbench.estimation.file_units import in_file_units, shared_units, within_bounds
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.parameters import shared_names
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.selection.answer import SIGMAS_95

DARK = 0.6
"""Correlation from which its number is white."""
PROFILE_SIGMAS = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)


def correlation(found: TraceComparison) -> Figure:
    """Correlation matrix of the values of the refit, but for those that were fixed."""
    of = found.baseline.current
    free = [i for i, value in enumerate(found.values.each) if value.refit_uncertainty is not None]
    size = np.sqrt(np.diag(of.covariance))[free]
    matrix = of.covariance[np.ix_(free, free)] / np.outer(size, size)
    names = [found.values.each[i].name.replace(".", "\n") for i in free]
    side = 1.1 * len(free) + 2.5
    figure = Figure(figsize=(side + 0.8, side), layout="constrained")
    axis = figure.subplots()
    image = axis.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    axis.set_xticks(range(len(free)), names, rotation=90, fontsize=7)
    axis.set_yticks(range(len(free)), names, fontsize=7)
    for (i, k), value in np.ndenumerate(matrix):
        axis.text(
            k,
            i,
            f"{value:.2f}",
            ha="center",
            va="center",
            fontsize=7,
            color="k" if abs(value) < DARK else "w",
        )
    figure.colorbar(image, label="correlation")
    return figure


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
    figure = Figure(figsize=(3.4 * len(free), 3.0), layout="constrained")
    axes = figure.subplots(1, len(free), squeeze=False)[0]
    centre, size = of.vector.shared, np.sqrt(np.diag(of.covariance))
    for axis, i in zip(axes, free, strict=True):
        told = []
        for sigmas in PROFILE_SIGMAS:
            at = within_bounds(of.parameters, centre + sigmas * size[i] * np.eye(centre.size)[i])
            held = fit(problem.fixing({names[i]: float(at[i])}), of.effects, of.vector, nuisance=of.nuisance)
            if held is not None:
                told.append((in_file_units(of.parameters, at)[i], held.objective - of.objective, sigmas))
        value, risen, away = np.array(told).T
        axis.plot(value, risen, "o-", ms=3, lw=1.0, color="tab:red", label="profile")
        axis.plot(value, away**2, ":", lw=1.0, color="0.3", label="as ± tells")
        axis.axhline(SIGMAS_95**2, color="0.8", lw=0.8)
        axis.set_xlabel(f"{names[i]}\n/ {units[i]}", fontsize=8)
        axis.tick_params(labelsize=7)
    axes[0].set_ylabel("−2 log posterior over its least")
    axes[0].legend(fontsize=7)
    return figure
