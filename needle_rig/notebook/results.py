"""What `compare` and `diagnose` answer."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from needle_rig.notebook.shown import Shown
from needle_rig.notebook.tables import Table, or_nan, table_of
from needle_rig.notebook.traced import Traced
from needle_rig.questions.diagnose import Diagnosed
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.learning.observations import Comparison as _Compared
from needle_rig.workbench.selection.answer import Answer

if TYPE_CHECKING:
    from needle_rig.figures.page import Figure


@dataclass(frozen=True, repr=False)
class Comparison(Traced):
    """Where a model fails on measurements."""

    found: _Compared

    @property
    def held_out_error(self) -> float:
        """Error on commands left out, in units of the noise; NaN where there is one command only."""
        return self.found.held_out_error

    @property
    def worst(self) -> tuple[str, ...]:
        """The places above three times their noise, the worst first, in words."""
        return tuple(f"{or_nan(p['sigmas']):.0f}σ  {p['words']}" for p in self.found.as_json()["worst"])

    def headline(self) -> str:
        """Dataset, model, the error with its values as they stand and on commands left out."""
        return " ".join(self.found.headline())

    def table(self) -> Table:
        """A row a channel: error, noise, and error in units of the noise; NaN where no noise is stated."""
        return table_of(
            {
                "channel": name,
                "rmse": float(v["rmse"]),
                "noise": or_nan(v["noise"]),
                "unit": v["unit"],
                "in_noise_units": or_nan(v["in_noise_units"]),
            }
            for name, v in self.found.channels.items()
        )

    def parameters(self) -> Table:
        """A row a value: of the model, of the refit, each with its σ, and their distance in σ of both.

        NaN where there is none: the null model has no values, a fixed one no σ.
        """
        return table_of(
            {
                "parameter": p["name"],
                "model": or_nan(p["model"]),
                "model_sigma": or_nan(p["model_uncertainty"]),
                "refit": or_nan(p["refit"]),
                "refit_sigma": or_nan(p["refit_uncertainty"]),
                "sigmas": or_nan(p["sigmas"]),
                "unit": p["unit"],
            }
            for p in self.found.as_json()["parameters"]
        )

    def places(self) -> Table:
        """A row for every channel, motion, state and direction."""
        return table_of(
            {
                "channel": p["channel"],
                "motion": p["motion"],
                "state": p["state"],
                "direction": p["direction"],
                "unit": p["unit"],
                "model": p["model"],
                "measured": p["measured"],
                "error": p["error"],
                "noise": or_nan(p["noise"]),
                "sigmas": or_nan(p["sigmas"]),
            }
            for p in self.found.places()
        )

    @property
    def redchi(self) -> float:
        """Reduced χ² of the model as it stands; of the fit where it has no values of its own."""
        return or_nan(self.found.as_json()["reduced_chi2"])

    @property
    def notes(self) -> tuple[str, ...]:
        """What else is to be known of the data and of the fit."""
        return tuple(self.found.as_json()["notes"])

    def _traces(self) -> TraceComparison:
        return self.found.traces()


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """Which effect is missing."""

    answer: Diagnosed

    @property
    def found(self) -> Answer:
        """The answer of the workbench."""
        return self.answer.found

    @property
    def verdict(self) -> str:
        """`effect`, `none` or `unknown`."""
        return self.found.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """What is missing, when the verdict is `effect`."""
        return self.found.effects

    @property
    def notes(self) -> tuple[str, ...]:
        """What else is to be known: of the data, of what was taken for noise, of what was not asked."""
        return self.found.notes

    def _repr_html_(self) -> str:
        from needle_rig.figures import page

        return super()._repr_html_() + "".join(map(page.paragraph, self.notes))

    def headline(self) -> str:
        """The verdict with the error left out, before and after."""
        found = self.found
        return (
            f"{found.dataset} against the model {found.model}: {found.sentence()} {found.errors_sentence()}"
        )

    @property
    def model_values(self) -> tuple[str, ...]:
        """Whether the values of the model hold as they stand, in words; empty for the null model."""
        values = self.answer.model_values()
        return () if values is None else tuple(values["sentences"])

    def table(self) -> Table:
        """The ranking: a row a candidate."""
        return table_of(
            {
                "effect": row.effect,
                "held_out_error": or_nan(row.held_out_error),
                "error_removed": row.error_removed,
                "for": row.in_favour,
                "against": row.against,
            }
            for row in self.found.ranking
        )

    def values(self) -> Table:
        """The fitted parameters of what is named, with 95 % intervals."""
        return table_of(
            ({"effect": row.effect, "parameter": v.name, "value": v.value, "low": v.low, "high": v.high,
             "unit": v.unit}
            for row in self.found.ranking[: len(self.found.effects)]
            for v in row.values),
            ("effect", "parameter", "value", "low", "high", "unit"),
        )  # fmt: skip

    def plot(self) -> Figure:
        """Error on commands left out by candidate, beside the current model and the noise."""
        from needle_rig.figures.diagnosis import ranking_figure

        return ranking_figure(self.found)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the diagnosis file that `needle-rig adopt` takes."""
        self.answer.save(path)
