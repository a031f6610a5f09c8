"""Where a model fails on settled values: each beside what the strategy's loop on the model gives.

The model has its own values, and beside them those of a refit; the null model has the latter alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from needle_rig.dataset.settled import SettledData, SettledValue
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.estimation.file_units import known_of, vector_of
from needle_rig.workbench.estimation.gaussian import Gaussian
from needle_rig.workbench.estimation.problem import EXACT
from needle_rig.workbench.published.fit import SettledProblem, held_out_error
from needle_rig.workbench.published.single_effects import settled_problem
from needle_rig.workbench.selection.answer import left_out_error
from needle_rig.workbench.selection.documents import (
    ChannelError,
    CompareDocument,
    MisfitDocument,
    PlaceError,
)
from needle_rig.workbench.selection.values import ComparedValues, compared_values, spelt_sigmas

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
            "model": self.model,
            "measured": self.measured.value,
            "error": abs(self.measured.value - self.model),
            "noise": self.measured.standard_error,
            "sigmas": self.sigmas,
            "unit": of.unit,
            "words": self.words,
        }


@dataclass(frozen=True)
class SettledMisfit:
    """What a model leaves of all values, as it stands or refitted."""

    values: tuple[Compared, ...]
    freedom: float
    """Degrees of freedom of the weighed values."""

    @property
    def error(self) -> float:
        """Root mean square over the weighed values, in standard errors."""
        return _rms([r.sigmas for r in self.values if r.sigmas is not None])

    @property
    def reduced_chi2(self) -> float:
        """Sum of squares over the degrees of freedom."""
        return sum((r.sigmas or 0.0) ** 2 for r in self.values) / max(self.freedom, 1.0)

    @property
    def worst(self) -> list[Compared]:
        """Rows beyond 3 standard errors, worst first."""
        return sorted(
            (r for r in self.values if (r.sigmas or 0.0) > NOISE_LIMIT), key=lambda r: -(r.sigmas or 0.0)
        )

    @property
    def channels(self) -> dict[str, ChannelError]:
        """By quantity, of the weighed values where there are any: rmse, noise, one over the other, unit."""
        found: dict[str, ChannelError] = {}
        for name in dict.fromkeys(r.measured.of.quantity for r in self.values):
            every = [r for r in self.values if r.measured.of.quantity == name]
            weighed = [r for r in every if r.sigmas is not None]
            rmse = _rms([r.measured.value - r.model for r in weighed or every])
            noise = _rms([r.measured.standard_error or 0.0 for r in weighed]) if weighed else None
            found[name] = {
                "rmse": rmse,
                "noise": noise,
                "in_noise_units": None if noise is None else rmse / noise,
                "unit": every[0].measured.of.unit,
                "whitened": _rms([r.sigmas or 0.0 for r in weighed]) if weighed else None,
                "by_phase": {
                    m: _rms([r.measured.value - r.model for r in every if r.measured.of.motion == m])
                    for m in dict.fromkeys(r.measured.of.motion for r in every)
                },
            }
        return found

    def as_json(self) -> MisfitDocument:
        """As it stands in the JSON answer."""
        return {
            "error": self.error,
            "reduced_chi2": self.reduced_chi2,
            "channels": self.channels,
            "worst": [r.as_json() for r in self.worst],
        }


@dataclass(frozen=True)
class SettledComparison:
    """The answer to `needle-rig compare` on settled values."""

    dataset: str
    model: str
    held: SettledMisfit | None
    """With the model's values as they stand; None for the null model, which has none."""
    refit: SettledMisfit
    values: ComparedValues
    held_out_error: float

    @property
    def shown(self) -> SettledMisfit:
        """The column that counts: the model as it stands, where it has values."""
        return self.held or self.refit

    @property
    def channels(self) -> dict[str, ChannelError]:
        """By quantity, of the column that counts."""
        return self.shown.channels

    def headline(self) -> tuple[str, str]:
        """The data's name, and what is said of them."""
        refit = (
            f"error on motions left out {left_out_error(self.held_out_error)} × the scatter,"
            f" reduced χ² {self.refit.reduced_chi2:.2f}"
        )
        if self.held is None:
            return self.dataset, f"against the model {self.model} (its values are fitted): {refit}"
        return self.dataset, (
            f"against the model {self.model}, its values as they stand: {self.held.error:.2f} × the scatter;"
            f" refitted: {self.refit.error:.2f} ×, {refit}"
        )

    def rows(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headings of the table by value, and its rows."""
        columns = [self.refit] if self.held is None else [self.held, self.refit]
        named = ("model",) if self.held is None else ("as it stands", "refitted")
        rows: list[tuple[str, ...]] = []
        for each in zip(*(of.values for of in columns), strict=True):
            error, of = each[0].measured.standard_error, each[0].measured.of
            scatter = "" if error is None else f" ± {error:g}"
            measured = f"{each[0].measured.value:g}{scatter} {of.unit}"
            cells = [cell for row in each for cell in (f"{row.model:.3g}", _apart(row.sigmas))]
            rows.append((each[0].words, measured, *cells))
        return ("value", "measured", *(h for name in named for h in (name, "apart"))), rows

    def sentences(self) -> list[str]:
        """Whether the model's values hold, and each beside that of the refit."""
        return self.value_sentences()

    def value_sentences(self) -> list[str]:
        """The same."""
        return self.values.sentences()

    def places(self) -> list[PlaceError]:
        """Every value."""
        return [r.as_json() | {"direction": ""} for r in self.shown.values]

    def traces(self) -> NoReturn:
        """Raises BadInput: there are none."""
        raise BadInput(f"{self.dataset} has settled values only, no traces to draw; ask for no picture")

    def as_json(self) -> CompareDocument:
        """The stated form of the answer."""
        shown = self.shown.as_json()
        return {
            "dataset": self.dataset,
            "model": self.model,
            "held": None if self.held is None else self.held.as_json(),
            "refit": self.refit.as_json(),
            "parameters": [value.as_json() for value in self.values.each],
            "contradiction_p": self.values.p,
            "free_parameters": self.values.fitted(),
            "held_out_error": self.held_out_error if np.isfinite(self.held_out_error) else None,
            "noise_floor": 1.0,
            "reduced_chi2": shown["reduced_chi2"],
            "channels": shown["channels"],
            "worst": shown["worst"],
            "values": [r.as_json() for r in self.shown.values],
            "notes": [],
        }


def compare_settled(
    data: SettledData,
    library: Mapping[str, type[Effect]],
    saved: SavedModel | None = None,
    *,
    refit_only: bool = False,
) -> SettledComparison:
    """Show all values beside the model, and beside its fit to the weighed ones; the null model is fitted.

    Raises BadInput, with file and line, for a sequence that cannot be run, SolverError.
    """
    problem, found = settled_problem(data, library, None if saved is None else saved.model)
    stated = float(np.log(data.needle.torsional_rigidity_nm2))
    at = found.x + np.r_[0.0, stated, np.zeros(len(found.parameters))]
    known, held = None, None
    if saved is not None and not refit_only:
        own = vector_of(found.parameters, saved.model)
        known = known_of(found.parameters, saved, Gaussian(own, np.zeros((own.size, own.size))))
        as_it_stands = dataclasses.replace(
            problem.base,
            friction_n=saved.model.friction_n,
            torsional_rigidity_nm2=saved.model.torsional_rigidity_nm2,
            effects=saved.model.effects,
        )
        held = SettledMisfit(_rows(problem, as_it_stands), float(len(problem.values)))
    refit = SettledMisfit(_rows(problem, problem.model(found.parameters, found.x)), found.freedom)
    pull = float(found.x[1]) / max(data.needle.rigidity_sigma, EXACT)
    values = compared_values(found.parameters, Gaussian(at, found.covariance), known, (), pull)
    return SettledComparison(
        data.name, problem.base.name, held, refit, values, held_out_error(problem, found)
    )


def _rows(problem: SettledProblem, model: NeedleModel) -> tuple[Compared, ...]:
    """All values beside those of the model."""
    data, runs = problem.data, problem.run(model)
    return tuple(Compared(v, problem.reading(runs, v.of), data.words(v.of)) for v in data.values)


def _apart(sigmas: float | None) -> str:
    return "not weighed" if sigmas is None else spelt_sigmas(sigmas)


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")
