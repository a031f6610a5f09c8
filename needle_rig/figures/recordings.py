"""A machine that is turned to and fro: loops of torque and lag, and what the model leaves of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from needle_rig.figures.figure import Figure, png
from needle_rig.numerics import Array
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.problem import Problem


def loops(problem: Problem, left: list[Array], shown: list[int]) -> Figure:
    """Torque and lag of the last sensor over the base angle, and residuals below, for the trials `shown`.

    `left` is data minus model in bin means (C, K) a trial.
    """
    figure = Figure(figsize=(4.2 * len(shown), 9.0), layout="constrained")
    axes = figure.subplots(4, len(shown), squeeze=False, sharex="col", sharey="row")
    for column, t in enumerate(shown):
        trial = problem.trials[t]
        base = deg(trial.base_rad)
        model = trial.mean - left[t]
        rows = (
            (nmm(trial.mean[0]), nmm(model[0]), "torque / N·mm"),
            (base - deg(trial.mean[-1]), base - deg(model[-1]), "lag / °"),
        )
        for row, (data, fitted, name) in enumerate(rows):
            axes[row, column].plot(base, data, ".", ms=4, color="0.4", label="measured")
            axes[row, column].plot(base, fitted, color="tab:red", lw=1.0, label="model")
            axes[row, 0].set_ylabel(name)
        rising = trial.base_rate_rad_s > 0.0
        for row, (channel, convert, name) in enumerate(
            ((0, nmm, "torque left / N·mm"), (-1, deg, "angle left / °")), start=2
        ):
            for way, label, colour in ((rising, "rising", "tab:blue"), (~rising, "falling", "tab:orange")):
                values = np.where(way, convert(left[t][channel]), np.nan)
                axes[row, column].plot(base, values, ".-", ms=4, lw=0.6, color=colour, label=label)
            axes[row, column].axhline(0.0, color="0.8", lw=0.6)
            axes[row, 0].set_ylabel(name)
        axes[0, column].set_title(", ".join(f"{value} {name}" for name, value in _told(trial.command)))
        axes[-1, column].set_xlabel("base angle / °")
    for row in (0, 2):
        axes[row, 0].legend(fontsize=8)
    return figure


def _told(command: object) -> list[tuple[str, str]]:
    speed = getattr(command, "speed_deg_s", None)
    load = dict(getattr(command, "other", ())).get("tip_torque_nmm", "0")
    return [("°/s", f"{speed:g}"), ("N·mm at the tip", load)]


def draw(problem: Problem, left: list[Array], path: Path) -> None:
    """Write the loops of the first trial of the slowest and fastest commands with each of two loads."""
    groups = problem.groups
    half = len(groups) // 2
    shown = [groups[k][0] for k in (0, half - 1, half, len(groups) - 1)]
    path.write_bytes(png(loops(problem, left, shown)))
