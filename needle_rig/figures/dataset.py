"""Figures of measurements alone, before any model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.figures.figure import Figure
from needle_rig.units import deg, nmm

MOST_NAMED = 10
"""Trials up to which a legend names them."""


def trial_figure(given: DatasetTrial, sensor_names: Sequence[str]) -> Figure:
    """Angles, and the torque below them, over time."""
    figure = Figure(figsize=(6.5, 4.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    time_s = given.trial.time_s
    above.plot(time_s, deg(given.base_measured_rad), color="k", lw=1.0, label="base")
    for place, name in enumerate(sensor_names):
        above.plot(time_s, deg(given.hall_rad[:, place]), lw=0.8, label=name)
    above.set_ylabel("angle / °")
    above.legend(fontsize=7)
    above.set_title(Path(given.file).name, fontsize=9)
    below.plot(time_s, nmm(given.torque_nm), color="tab:red", lw=0.8)
    below.set_ylabel("base torque / N·mm")
    below.set_xlabel("time / s")
    return figure


def dataset_figure(dataset: Dataset) -> Figure:
    """Torque and the last sensor's angle over the base angle, a line a trial."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for given in dataset.trials:
        base_deg, name = deg(given.base_measured_rad), Path(given.file).stem
        left.plot(base_deg, nmm(given.torque_nm), lw=0.8, label=name)
        if dataset.sensor_names:
            right.plot(base_deg, deg(given.hall_rad[:, -1]), lw=0.8)
    left.set_ylabel("base torque / N·mm")
    right.set_ylabel(f"{dataset.sensor_names[-1]} / °" if dataset.sensor_names else "no Hall sensor")
    for axis in (left, right):
        axis.set_xlabel("base angle / °")
    if len(dataset.trials) <= MOST_NAMED:
        left.legend(fontsize=7)
    return figure
