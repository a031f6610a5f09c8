"""What a model leaves on traces, bin by bin, and its figures: of `compare`, `fit` and `identify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needle_rig.notebook.shown import Shown
from needle_rig.notebook.tables import Table, columns_of, frame, stacked
from needle_rig.units import deg
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.learning.misfit import modelled
from needle_rig.workbench.learning.places import scale_of

if TYPE_CHECKING:
    from pandas import DataFrame

    from needle_rig.figures.page import Figure


class Traced(Shown):
    """A result that has a model beside every reading."""

    def _traces(self) -> TraceComparison:
        raise NotImplementedError

    def residuals(self) -> DataFrame:
        """A row a bin of readings: measured, model, their difference, and that in σ as the fit weighs it.

        Degrees and N·mm, as `unit` says. Raises BadInput without pandas, or for settled values.
        """
        return frame(stacked(_residuals(self._traces())))

    def predict(self) -> DataFrame:
        """A row a time of every trial: base, torque and Hall angles as the model predicts them.

        Degrees and N·mm. Raises BadInput without pandas, or for settled values.
        """
        return frame(stacked(_predicted(self._traces())))

    def plot(self, what: str = "residuals") -> Figure:
        """`residuals`: error over noise by channel, phase and direction; or another figure by its name.

        There are `traces`, `pulls`, `loop`, `strips`, `over_time`, `over_model`, `qq`, `autocorrelation`,
        `correlation`, `profile` and `band`. Raises BadInput, also for settled values, which have no traces.
        """
        from needle_rig.figures.residuals import drawn

        return drawn(self._traces(), what)


def _residuals(found: TraceComparison) -> list[Table]:
    problem, fit = found.baseline.problem, found.shown.fit
    left_of = problem.raw(fit.residuals)
    tables = []
    for t, binned in enumerate(problem.trials):
        for c, name in enumerate(("torque", *found.baseline.dataset.sensor_names)):
            factor, unit = scale_of(c)
            use = problem.whiteners[t].use[c]
            measured, left = factor * binned.mean[c, use], factor * left_of[t][c, use]
            tables.append(
                columns_of(
                    {
                        "trial": np.full(use.size, Path(binned.file).stem),
                        "channel": np.full(use.size, name),
                        "time_s": binned.time_s[use],
                        "base_deg": deg(binned.base_rad[use]),
                        "measured": measured,
                        "model": measured - left,
                        "residual": left,
                        "sigmas": fit.residuals[t][problem.whiteners[t].channel == c],
                        "unit": np.full(use.size, unit),
                    }
                )
            )
    return tables


def _predicted(found: TraceComparison) -> list[Table]:
    problem, fit = found.baseline.problem, found.shown.fit
    names = ("torque_nmm", *(f"{name}_deg" for name in found.baseline.dataset.sensor_names))
    tables = []
    for t, binned in enumerate(problem.trials):
        model = modelled(problem, fit, t)
        columns = {name: scale_of(c)[0] * model[c] for c, name in enumerate(names)}
        time_s = binned.trial.time_s
        tables.append(
            columns_of(
                {
                    "trial": np.full(len(time_s), Path(binned.file).stem),
                    "time_s": time_s,
                    "base_deg": deg(binned.trial.base_angle_rad),
                    **columns,
                }
            )
        )
    return tables
