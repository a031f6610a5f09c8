"""A model with what is known of it, and a strategy's sequence on it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from needle_rig.model import SavedModel, save_model
from needle_rig.notebook.params import Param, Params, correl_of
from needle_rig.notebook.shown import Shown
from needle_rig.notebook.tables import Table, table_of
from needle_rig.units import deg, nmm
from needle_rig.workbench.learning.history import ladder
from needle_rig.workbench.selection.answer import SIGMAS_95
from needle_rig.workbench.virtual.settled_run import SettledRun

if TYPE_CHECKING:
    from needle_rig.figures.page import Figure


@dataclass(frozen=True, repr=False)
class Model(Shown):
    """A model with its uncertainties and the steps in which it was learnt."""

    saved: SavedModel

    @property
    def params(self) -> Params:
        """Every parameter with its uncertainty, where the model file knows one."""
        return params_of_model(self.saved)

    @property
    def values(self) -> Mapping[str, Any]:
        """Every parameter by name, in the units of files."""
        return self.saved.model.values()

    def headline(self) -> str:
        """The model's name and effects."""
        effects = ", ".join(e.name() for e in self.saved.model.effects) or "no effect"
        count = len(self.saved.history)
        steps = f"{count} step{'' if count == 1 else 's'} from {self.saved.starts_from}"
        return f"{self.saved.model.name}: {effects}, {steps}"

    def table(self) -> Table:
        """The ladder: a row a step, errors in units of the noise."""
        return table_of(
            {
                "step": step.label,
                "date": step.date,
                "dataset": step.dataset,
                "training": np.nan if step.training is None else step.training,
                "held_out": np.nan if step.held_out is None else step.held_out,
                "noise_floor": np.nan if step.floor is None else step.floor,
            }
            for step in ladder(self.saved)
        )

    def plot(self) -> Figure:
        """How the error fell, over all and for each channel."""
        from needle_rig.figures.ladder import ladder_figure

        return ladder_figure(self.saved)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model file that commands take as --model."""
        save_model(path, self.saved)


@dataclass(frozen=True, repr=False)
class Plan(Shown):
    """A sequence of motions carried out on the model, and where it leaves the needle."""

    target_deg: float
    strategy: str
    run: SettledRun

    def headline(self) -> str:
        """What it leaves, and what it costs."""
        left_deg = deg(abs(self.run.history[-1].base_angle_rad - self.run.tip_rad))
        return (
            f"{self.strategy} to {self.target_deg:g}°: the tip lags {left_deg:.1f}°,"
            f" {nmm(abs(self.run.torque_nm)):.3f} N·mm are left, after {self.run.rotations} rotations and"
            f" {self.run.time_s:.0f} s"
        )

    def table(self) -> Table:
        """A row a motion, after it has settled."""
        return table_of(
            {
                "motion": m.name,
                "waypoint_deg": deg(m.waypoint_rad),
                "base_deg": deg(m.base_angle_rad),
                "torque_nmm": nmm(m.torque_nm),
                "tip_lag_deg": deg(m.tip_lag_rad),
                "time_s": m.time_s,
            }
            for m in self.run.history[1:]
        )

    def plot(self) -> Figure:
        """The base on its way, and the shaft at the end."""
        from needle_rig.figures.plan import plan_figure

        return plan_figure(self.run, self.target_deg, self.strategy)


def params_of_model(saved: SavedModel) -> Params:
    """The values of a model as its file tells them, each ± as a normal distribution."""
    params = {}
    for name, value in saved.model.values().items():
        size = saved.uncertainties.get(name)
        ends = None if size is None else (value - SIGMAS_95 * size, value + SIGMAS_95 * size)
        unit = saved.model.info(name).unit
        params[name] = Param(name, value, size, ends, unit, correl_of(name, saved.correlations))
    return Params(saved.model.name, params)
