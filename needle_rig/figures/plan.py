"""A sequence carried out on a needle: the base on its way, and the shaft at the end."""

from __future__ import annotations

import numpy as np

from needle_rig.figures.figure import Figure
from needle_rig.units import deg, mm
from needle_rig.workbench.contest.strategies_table import SPEED_DEG_S
from needle_rig.workbench.virtual.settled_run import SettledRun


def plan_figure(run: SettledRun, target_deg: float, name: str) -> Figure:
    """The base over time and the shaft's angle along the needle at the end, with the target."""
    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    way, shaft = figure.subplots(1, 2)
    time_s, base_deg = base_path(run)
    way.plot(time_s, base_deg, color="#0b6e4f", label="base")
    way.set(xlabel="time / s", ylabel="angle / °", title=f"{name}, {run.rotations} rotations")
    shaft.plot(mm(run.position_m), np.degrees(run.shaft_rad), color="#0b6e4f", label="shaft")
    shaft.set(xlabel="place along the needle / mm", ylabel="angle / °", title="the shaft at the end")
    for axes in (way, shaft):
        axes.axhline(target_deg, color="black", linewidth=1.0, linestyle="--", label="target")
        axes.legend(frameon=False, fontsize=8)
    return figure


def base_path(run: SettledRun) -> tuple[list[float], list[float]]:
    """Corners of the base's path: time in seconds, degrees."""
    times, angles = [0.0], [deg(run.history[0].base_angle_rad)]
    for motion in run.history[1:]:
        travel = abs(deg(motion.base_angle_rad) - angles[-1]) / SPEED_DEG_S
        times += [motion.moved_s, motion.moved_s + travel, motion.time_s]
        angles += [angles[-1], deg(motion.base_angle_rad), deg(motion.base_angle_rad)]
    return times, angles
