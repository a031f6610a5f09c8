"""Where a model fails on settled values: each beside what the strategy's loop on the fitted model gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from needle_rig.dataset.settled import SettledData, SettledValue
from needle_rig.errors import BadInput
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import TORSIONAL_RIGIDITY, NeedleModel
from needle_rig.workbench.published.fit import held_out_error
from needle_rig.workbench.published.search import settled_problem
from needle_rig.workbench.selection.answer import fitted_sentences, left_out_error
from needle_rig.workbench.selection.documents import ChannelError, CompareDocument, FittedNumber, PlaceError

NOISE_LIMIT = 3.0


@dataclass(frozen=True)
class Compared:
    """One reported value and the model's."""

    measured: SettledValue
    model: float
    words: str

    @property
    def sigmas(self) -> float | None:
        """Distance in standard errors; None where none is stated."""
        error = self.measured.standard_error
        return None if error is None else abs(self.measured.value - self.model) / error

    def as_json(self) -> PlaceError:
        """As it stands in the JSON answer."""
        of = self.measured.of
        return {
            "channel": of.quantity,
            "motion": of.motion,
            "state": "settled",
            "model": round(self.model, 5),
            "measured": self.measured.value,
            "error": round(abs(self.measured.value - self.model), 5),
            "noise": self.measured.standard_error,
            "sigmas": None if self.sigmas is None else round(self.sigmas, 2),
            "unit": of.unit,
            "words": self.words,
        }


@dataclass(frozen=True)
class SettledComparison:
    """The answer to `needle-rig compare` on settled values."""

    dataset: str
    model: str
    values: tuple[Compared, ...]
    free_parameters: dict[str, FittedNumber]
    reduced_chi2: float
    held_out_error: float

    @property
    def worst(self) -> list[Compared]:
        """Rows beyond 3 standard errors, worst first."""
        return sorted(
            (r for r in self.values if (r.sigmas or 0.0) > NOISE_LIMIT), key=lambda r: -(r.sigmas or 0.0)
        )

    def headline(self) -> tuple[str, str]:
        """The data's name, and what is said of them."""
        return self.dataset, (
            f"against the model {self.model}: error on motions left out"
            f" {left_out_error(self.held_out_error)} × the scatter, reduced χ² {self.reduced_chi2:.2f}"
        )

    def rows(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headings of the table by value, and its rows."""
        rows: list[tuple[str, ...]] = []
        for row in self.values:
            error, of = row.measured.standard_error, row.measured.of
            apart = "not weighed" if row.sigmas is None else f"{row.sigmas:.1f}σ"
            scatter = "" if error is None else f" ± {error:g}"
            rows.append((row.words, f"{row.measured.value:g}{scatter} {of.unit}", f"{row.model:.3g}", apart))
        return ("value", "measured", "model", "apart"), rows

    def sentences(self) -> list[str]:
        """The fitted parameters."""
        return fitted_sentences(self.free_parameters)

    def places(self) -> list[PlaceError]:
        """Every value."""
        return [r.as_json() | {"direction": ""} for r in self.values]

    def traces(self) -> NoReturn:
        """Raises BadInput: there are none."""
        raise BadInput(
            f"{self.dataset} has settled values only, no traces to draw; leave out --html and --png, and plot"
        )

    def as_json(self) -> CompareDocument:
        """The stated form of the answer."""
        return {
            "dataset": self.dataset,
            "model": self.model,
            "free_parameters": self.free_parameters,
            "held_out_error": round(self.held_out_error, 4) if np.isfinite(self.held_out_error) else None,
            "noise_floor": 1.0,
            "reduced_chi2": round(self.reduced_chi2, 4),
            "channels": self.channels,
            "worst": [r.as_json() for r in self.worst],
            "values": [r.as_json() for r in self.values],
            "notes": [],
        }

    @property
    def channels(self) -> dict[str, ChannelError]:
        """By quantity: rmse, noise, unit, whitened (the error in standard errors), by_phase."""
        found: dict[str, ChannelError] = {}
        for name in dict.fromkeys(r.measured.of.quantity for r in self.values):
            rows = [r for r in self.values if r.measured.of.quantity == name]
            errors = [r.measured.standard_error for r in rows if r.measured.standard_error is not None]
            found[name] = {
                "rmse": round(_rms([r.measured.value - r.model for r in rows]), 5),
                "noise": round(_rms(errors), 5) if errors else None,
                "unit": rows[0].measured.of.unit,
                "whitened": round(_rms([r.sigmas for r in rows if r.sigmas is not None]), 3)
                if errors
                else None,
                "by_phase": {
                    m: round(_rms([r.measured.value - r.model for r in rows if r.measured.of.motion == m]), 5)
                    for m in dict.fromkeys(r.measured.of.motion for r in rows)
                },
            }
        return found


def compare_settled(
    data: SettledData, library: Mapping[str, type[Effect]], model: NeedleModel | None = None
) -> SettledComparison:
    """Fit the model (default: the null model) to the weighed values and show all of them beside it.

    Raises BadInput, with file and line, for a sequence that cannot be run.
    """
    problem, found = settled_problem(data, library, model)
    fitted = problem.model(found.parameters, found.x)
    runs = problem.run(fitted)
    rows = tuple(Compared(v, problem.reading(runs, v.of), data.words(v.of)) for v in data.values)
    free: dict[str, FittedNumber] = {
        name: {"value": float(f"{value:.6g}"), "unit": fitted.info(name).unit}
        for name, value in fitted.values().items()
    }
    sigma = max(data.needle.rigidity_sigma, 1e-4)
    free[TORSIONAL_RIGIDITY]["pull_sigma"] = round(float(found.x[1]) / sigma, 2)
    return SettledComparison(
        data.name,
        problem.base.name,
        rows,
        free,
        found.chi2 / max(found.freedom, 1.0),
        held_out_error(problem, found),
    )


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
