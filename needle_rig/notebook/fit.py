"""A fit in the words of lmfit, and constants identified from a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from needle_rig.model import save_model
from needle_rig.notebook.model import Model
from needle_rig.notebook.params import Param, Params, correl_of
from needle_rig.notebook.tables import Table, or_nan, table_of
from needle_rig.notebook.traced import Traced
from needle_rig.questions.identify import Identified
from needle_rig.workbench.learning.compare import TraceComparison, compared
from needle_rig.workbench.learning.fit_effects import correlations, fitted_model, intervals
from needle_rig.workbench.learning.identify import Identification as Found
from needle_rig.workbench.selection.answer import left_out_error


@dataclass(frozen=True, repr=False)
class Fit(Traced):
    """A model fitted to traces: values with ±, 95 % interval and unit, what it leaves, and its figures."""

    found: TraceComparison

    @cached_property
    def params(self) -> Params:
        """Each value by name: value, stderr, interval, unit, vary, correl."""
        ends = intervals(self.found)
        correl = correlations(self.found)
        return Params(
            self.found.baseline.problem.base.name,
            {
                of.name: Param(
                    of.name,
                    of.refit,
                    of.refit_uncertainty,
                    ends.get(of.name),
                    of.unit,
                    correl_of(of.name, correl),
                )
                for of in self.found.values.each
            },
        )

    @property
    def chisqr(self) -> float:
        """Sum of squared residuals, each in units of its noise."""
        return self.found.baseline.current.chi2

    @property
    def ndata(self) -> int:
        """Number of readings, in bins."""
        return self.found.baseline.problem.size

    @property
    def nvarys(self) -> int:
        """Number of values that were fitted; each trial's own friction is not one of them."""
        return sum(param.vary for param in self.params.values())

    @property
    def redchi(self) -> float:
        """Reduced χ²: about 1 where the model leaves noise alone."""
        return self.found.refit.reduced_chi2

    @property
    def held_out_error(self) -> float:
        """Error on commands left out, in units of the noise; infinite where there is one command only."""
        return self.found.held_out_error

    @property
    def notes(self) -> tuple[str, ...]:
        """What else is to be known of the data and of the fit."""
        return tuple(self.found.notes)

    @property
    def model(self) -> Model:
        """The fitted model, to compare, plan and save."""
        return Model(fitted_model(self.found))

    def headline(self) -> str:
        """Data, model, error on commands left out, reduced χ²."""
        problem = self.found.baseline.problem
        return (
            f"{problem.name} fitted with {problem.base.name}: error on commands left out"
            f" {left_out_error(self.held_out_error)} × the noise, reduced χ² {self.redchi:.2f}"
        )

    def table(self) -> Table:
        """A row a value: value, stderr, 95 % interval, unit."""
        return self.params.table()

    def report(self) -> str:
        """Statistics, variables and correlations, as lmfit's fit_report writes them."""
        return "\n".join(
            [
                "[[Fit Statistics]]",
                f"    # data points      = {self.ndata}",
                f"    # variables        = {self.nvarys}",
                f"    chi-square         = {self.chisqr:.6g}",
                f"    reduced chi-square = {self.redchi:.6g}",
                f"    error left out     = {left_out_error(self.held_out_error)} x noise",
                self.params.report(),
            ]
        )

    def _traces(self) -> TraceComparison:
        return self.found


@dataclass(frozen=True, repr=False)
class Identification(Traced):
    """Constants of a rig from its own recording, or the experiment that would give them."""

    answer: Identified

    @property
    def found(self) -> Found:
        """The answer of the workbench."""
        return self.answer.found

    @cached_property
    def params(self) -> Params:
        """What the recording gives, by name."""
        correl = self.answer.saved("identified").correlations
        return Params(
            self.found.baseline.problem.name,
            {
                of.name: Param(
                    of.name,
                    of.value,
                    of.uncertainty,
                    of.interval,
                    of.unit,
                    correl_of(of.name, correl),
                )
                for of in self.found.estimates
                if of.value is not None
            },
        )

    @property
    def experiments(self) -> Mapping[str, str]:
        """What would have to be recorded for each constant that the recording does not give."""
        return {of.name: of.experiment for of in self.found.estimates if of.value is None}

    @property
    def misfit(self) -> float:
        """Root mean square of what the model leaves, in units of the noise."""
        return self.found.misfit

    def headline(self) -> str:
        """The data, how many constants they give, and what the model leaves."""
        told, asked = len(self.params), len(self.experiments)
        more = f", {asked} would need another experiment" if asked else ""
        return (
            f"{self.found.baseline.problem.name}: {told} constants identified{more};"
            f" the model leaves {self.misfit:.2f} × the noise"
        )

    def table(self) -> Table:
        """A row a constant; NaN where the recording does not give it."""
        return table_of(
            {
                "parameter": of.name,
                "value": or_nan(of.value),
                "stderr": or_nan(of.uncertainty),
                "low": np.nan if of.interval is None else of.interval[0],
                "high": np.nan if of.interval is None else of.interval[1],
                "unit": of.unit,
                "experiment": of.experiment,
            }
            for of in self.found.estimates
        )

    def report(self) -> str:
        """Every constant in a sentence, and notes."""
        return "\n".join(self.found.sentences())

    def model(self, name: str = "identified") -> Model:
        """The model with these values; those not identified stay as they were known before."""
        return Model(self.answer.saved(name))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model file, named as its file."""
        save_model(path, self.answer.saved(os.path.splitext(os.path.basename(path))[0]))

    def _traces(self) -> TraceComparison:
        return compared(self.found.baseline)
