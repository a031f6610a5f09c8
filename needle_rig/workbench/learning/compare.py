"""A model held against measurements: with its values as they stand, and with those that a refit wants.

Held are the values of the model that all trials share. What is a trial's own stays estimated, in both
columns: its friction about the common one, its start, and the coefficient of the discretisation error.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.estimation.baseline import Baseline, fit_baseline, null_model
from needle_rig.workbench.estimation.file_units import known_of, values_by_name, vector_of
from needle_rig.workbench.estimation.gaussian import Gaussian
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.parameters import shared_names
from needle_rig.workbench.estimation.unseen import unseen_names
from needle_rig.workbench.learning.misfit import Misfit, finite, misfit
from needle_rig.workbench.learning.places import NOISE_LIMIT
from needle_rig.workbench.learning.steps import numbered
from needle_rig.workbench.selection.answer import Say, left_out_error
from needle_rig.workbench.selection.documents import (
    ChannelError,
    CompareDocument,
    FittedNumber,
    PlaceError,
    ValuesDocument,
)
from needle_rig.workbench.selection.values import ComparedValues, compared_values, with_uncertainty

TOLD_SIGMAS = 3.0
"""Distance of a value from the model's above which a diagnosis tells it: one in 370 that agree."""
SHIFTED_RATIO = math.sqrt(2.0)
"""Whitened error over error by size, from which most of the noise's variance is what a trial's readings
share."""
LEARNT_HERE = "the model's history names data called so: if they are these, its values were fitted to them"
NULL = "null"
"""Name of the model without values of its own."""


@dataclass(frozen=True)
class Held:
    """Which values are held, and which are fitted."""

    refit_only: bool = False
    """Leave the column with the model's own values out."""
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Values, in the units of files, that stand in place of the model's and that no fit moves."""
    free: Collection[str] = ()
    """Values that are fitted in the column with the model's own values, too."""


@dataclass(frozen=True)
class TraceComparison:
    """The answer to `needle-rig compare` on traces."""

    baseline: Baseline = field(repr=False)
    held: Misfit | None
    """With the model's values as they stand; None for the null model, which has none."""
    refit: Misfit
    values: ComparedValues
    free: tuple[str, ...] = ()
    """Values that are fitted in `held`, too."""
    learnt_here: bool = False
    """Whether the model's history names these data: then its values were fitted to them."""

    @property
    def shown(self) -> Misfit:
        """The column that counts: the model as it stands, where it has values."""
        return self.held or self.refit

    @property
    def held_out_error(self) -> float:
        """Error of the refit in cross-validation, in units of the noise; infinite with one command alone."""
        return self.baseline.validation.error

    @property
    def channels(self) -> dict[str, ChannelError]:
        """By channel, of the column that counts."""
        return self.shown.channels

    def headline(self) -> tuple[str, str]:
        """The dataset's name, and what is said of it."""
        model = self.baseline.problem.base.name
        left_out = (
            f"error on commands left out {left_out_error(self.held_out_error)} × the noise"
            if np.isfinite(self.held_out_error)
            else "no error on commands left out, as the fit could not be repeated without one"
        )
        refit = f"{left_out}, reduced χ² {self.refit.reduced_chi2:.2f}"
        if self.held is None:
            fitted = "its two constants are fitted" if model == NULL else "its values are fitted"
            fixed = [v.name for v in self.values.each if v.refit_uncertainty is None or not v.seen]
            if len(fixed) == len(self.values.each):
                fitted = "none of its values is fitted"
            elif fixed:
                fitted += f" but for {', '.join(fixed)}"
            return self.baseline.dataset.name, f"against the model {model} ({fitted}): {refit}"
        but = f" but for {', '.join(self.free)}, fitted" if self.free else ""
        return self.baseline.dataset.name, (
            f"against the model {model}, its values as they stand{but}: {self.held.error:.2f} × the noise;"
            f" refitted: {self.refit.error:.2f} ×, {refit}"
        )

    def rows(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headings of the table by channel, and its rows."""
        columns = [self.refit] if self.held is None else [self.held, self.refit]
        named = ("rmse",) if self.held is None else ("as it stands", "refitted")
        headings = [h for name in named for h in (name, "noise", "rmse / noise")]
        rows: list[tuple[str, ...]] = []
        for name in self.refit.channels:
            told = [of.channels[name] for of in columns]
            cells = [
                (
                    f"{of['rmse']:.4g} {of['unit']}",
                    f"{of['noise']:.4g} {of['unit']}",
                    ratio(of["in_noise_units"]),
                )
                for of in told
            ]
            rows.append((name, *(cell for each in cells for cell in each)))
        return ("channel", *headings), rows

    def sentences(self) -> list[str]:
        """The worst places, the values, the trials' own friction, and notes."""
        worst = ["Worst places:"] if self.shown.worst else ["No place is above 3 × its noise."]
        worst += [f"  {place.sigmas:6.0f}σ  {place.words}" for place in self.shown.worst]
        return [*worst, *self.value_sentences(), *(f"note: {n}" for n in self.notes)]

    def value_sentences(self) -> list[str]:
        """Whether the model's values hold, each beside that of the refit, and the trials' own friction."""
        found = self.baseline.current
        percent = with_uncertainty(100 * found.scatter, 100 * self._scatter_uncertainty)
        own = f"each trial's own: its friction about the common one, scatter {percent} %"
        return [*self.values.sentences(), own]

    def verdict_on_values(self, *, structure_holds: bool) -> list[str]:
        """What a diagnosis says of the values before it speaks of the structure; nothing without values."""
        if self.held is None:
            return []
        said = (
            f"its values as they stand leave {self.held.error:.2f} × the noise, a refit of the same structure"
            f" {self.refit.error:.2f} ×: {self.values.sentence()}"
        )
        moved = [value.sentence() for value in self.values.each if abs(value.sigmas or 0.0) > TOLD_SIGMAS]
        if self.values.contradict and not structure_holds:
            moved.append("what the structure lacks may be what moves these values: see to that first")
        if self.learnt_here:
            moved.append(LEARNT_HERE)
        return [said, *moved]

    @property
    def _scatter_uncertainty(self) -> float:
        """Of the relative scatter: its posterior is a scaled inverse χ²."""
        return self.baseline.current.scatter / float(np.sqrt(2.0 * self.baseline.current.scatter_dof))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the dataset and of the baseline fit."""
        learnt = (LEARNT_HERE,) if self.learnt_here else ()
        return *learnt, *self._shifted(), *self.baseline.dataset.notes, *self.baseline.notes

    def _shifted(self) -> list[str]:
        """Channels whose noise is large, but moves all readings of a trial alike, as their error does not."""
        said = []
        for name, of in self.channels.items():
            whitened, size = of["whitened"] or 0.0, of["in_noise_units"] or np.inf
            if whitened > max(SHIFTED_RATIO * size, NOISE_LIMIT):
                said.append(
                    f"{name}: most of its noise of {of['noise']:.2g} {of['unit']} shifts all readings of a"
                    " trial alike, as an unknown twist at the start does. The table divides by that; the"
                    " error on commands left out counts what no shift explains: here"
                    f" {left_out_error(whitened)} × the rest of the noise."
                )
        return said

    def places(self) -> list[PlaceError]:
        """Every channel × motion × state × direction."""
        return [p.as_json() for p in self.shown.places]

    def traces(self) -> TraceComparison:
        """What can be drawn: all of it."""
        return self

    @property
    def free_parameters(self) -> dict[str, FittedNumber]:
        """What the refit found, by name."""
        free = self.values.fitted()
        free["friction_scatter"] = {
            "value": self.baseline.current.scatter,
            "unit": "1",
            "uncertainty": self._scatter_uncertainty,
        }
        return free

    def as_json(self) -> CompareDocument:
        """The stated form of the answer."""
        shown = self.shown.as_json()
        return {
            "dataset": self.baseline.dataset.name,
            "model": self.baseline.problem.base.name,
            "held": None if self.held is None else self.held.as_json(),
            "refit": self.refit.as_json(),
            "parameters": [value.as_json() for value in self.values.each],
            "contradiction_p": self.values.p,
            "free_parameters": self.free_parameters,
            "held_out_error": finite(self.held_out_error),
            "noise_floor": 1.0,
            "reduced_chi2": shown["reduced_chi2"],
            "channels": shown["channels"],
            "worst": shown["worst"],
            "notes": list(self.notes),
        }

    def worst_trials(self) -> list[int]:
        """All trials: those of the worst places, the worst first, then those of the largest error."""
        files = [binned.file for binned in self.baseline.problem.trials]
        worst = sorted(self.shown.places, key=lambda place: -place.sigmas)
        largest = np.argsort(-self.shown.trial_errors).tolist()
        return list(dict.fromkeys((*(files.index(place.trial) for place in worst), *largest)))


def known_value(model: NeedleModel, name: str) -> None:
    """Raises BadInput where the model has no value of this name."""
    names = tuple(model.values())
    if name not in names:
        raise BadInput(f"{name}: no value of the model {model.name}; it has {', '.join(names)}")


def ratio(value: float | None) -> str:
    """Error over noise for a table."""
    return "—" if value is None else f"{value:.3g}"


def compare(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    saved: SavedModel | None = None,
    held: Held | None = None,
    say: Say = lambda _: None,
) -> TraceComparison:
    """Hold a model against the dataset, and fit it; the null model is fitted alone.

    Raises BadInput, SolverError.
    """
    held = held or Held()
    model = None if saved is None else saved.model
    if held.fixed or held.free:
        model = model or null_model(dataset)
        for name in (*held.fixed, *held.free):
            known_value(model, name)
        if both := set(held.fixed) & set(held.free):
            raise BadInput(f"{min(both)} is both fixed and free; name it once")
        if held.free and (saved is None or held.refit_only):
            raise BadInput(f"free {min(held.free)}: it is fitted already; leave it out")
        model = model.replaced(held.fixed)
    stands = saved is not None and not held.refit_only
    step = numbered(say, 3 if stands else 2)
    baseline = fit_baseline(dataset, model, library, fixed=tuple(held.fixed), say=step)
    if saved is not None and model is not None:
        known = {name: size for name, size in saved.uncertainties.items() if name not in held.fixed}
        saved = dataclasses.replace(saved, model=model, uncertainties=known)
    if stands:
        step("holding its values as they stand")
    return compared(baseline, saved if stands else None, tuple(held.free))


def compared(
    baseline: Baseline, saved: SavedModel | None = None, free: tuple[str, ...] = ()
) -> TraceComparison:
    """The comparison of a model that is fitted already, held at the values of `saved` but for those `free`.

    Raises BadInput where it cannot be solved at these.
    """
    problem, found = baseline.problem, baseline.current
    names = ("torque", *baseline.dataset.sensor_names)
    refit = Gaussian(found.vector.shared, found.covariance)
    known, column = None, None
    if saved is not None:
        at = vector_of(found.parameters, saved.model)
        known = known_of(found.parameters, saved, Gaussian(at, np.zeros((at.size, at.size))))
        column = _held(baseline, saved, free, known, names)
    pull = found.pull_rigidity if baseline.dataset.needle.rigidity_is_known else None
    unseen = unseen_names(problem, found)
    values = compared_values(found.parameters, refit, known, problem.fixed, pull, unseen)
    learnt = saved is not None and problem.name in {entry.dataset for entry in saved.history}
    return TraceComparison(baseline, column, misfit(problem, found, names), values, free, learnt)


def values_document(found: TraceComparison, *, structure_holds: bool) -> ValuesDocument:
    """Whether the model's values hold, as it stands in the JSON of a diagnosis."""
    return {
        "held_error": None if found.held is None else finite(found.held.error),
        "refit_error": finite(found.refit.error),
        "contradiction_p": found.values.p,
        "contradict": found.values.contradict,
        "parameters": [value.as_json() for value in found.values.each],
        "sentences": found.verdict_on_values(structure_holds=structure_holds),
    }


def _held(
    baseline: Baseline, saved: SavedModel, free: Collection[str], known: Gaussian, names: tuple[str, ...]
) -> Misfit:
    """What the model leaves with its own values, each trial's own friction fitted about the common one."""
    problem, found = baseline.problem, baseline.current
    values = values_by_name(found.parameters, saved.model)
    holding = problem.fixing({name: value for name, value in values.items() if name not in free})
    vector = dataclasses.replace(found.vector, trial_friction=np.zeros(len(problem.trials)))
    held = fit(holding, found.effects, vector)
    if held is None:
        raise BadInput(
            f"{saved.model.name} cannot be solved on {problem.name} with its values as they stand; look at"
            " them, or compare with those of a refit alone"
        )
    fixed = [n in holding.fixed for n in shared_names(found.parameters)]
    scatter = found.scatter / np.sqrt(len(np.unique(problem.recorded)))
    return misfit(holding, held, names, _not_fitted(known, np.array(fixed), float(scatter)))


def _not_fitted(known: Gaussian, fixed: Array, scatter: float) -> Array:
    """Deviations (p + 1, m) of what is held: the model's uncertainty, and that of the trials' mean friction.

    That mean is a draw about the common one.
    """
    covariance = known.covariance * np.outer(fixed, fixed)
    variances, directions = np.linalg.eigh(covariance)
    own = directions * np.sqrt(np.maximum(variances, 0.0))
    mean = np.zeros((fixed.size + 1, 1))
    mean[-1] = scatter * fixed[0]
    return np.hstack([np.vstack([own, np.zeros((1, fixed.size))]), mean])
