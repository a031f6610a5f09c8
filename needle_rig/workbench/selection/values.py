"""The values of a model beside those that a refit of the same structure wants."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.file_units import (
    deviations_in_file_units,
    in_file_units,
    shared_units,
    within_bounds,
)
from needle_rig.workbench.estimation.gaussian import Gaussian
from needle_rig.workbench.estimation.parameters import FreeParameter, shared_names
from needle_rig.workbench.selection.documents import ComparedNumber, FittedNumber

CONTRADICTS = 1e-3
"""p value below which data contradict a model's values: one in a thousand that agree is refused."""
LEAST_P = 1e-9
"""p value that is reported: a normal distribution is not known farther out."""
FARTHEST_SIGMAS = 8.0
"""Distance up to which a figure is given: farther out (p = 1e-15) it says no more. The page has the same."""
MOST_DECIMALS = 9


@dataclass(frozen=True)
class ComparedValue:
    """One value, in the unit of files."""

    name: str
    unit: str
    refit: float
    refit_uncertainty: float | None
    """One standard deviation; None for a value that was fixed."""
    model: float | None = None
    """What the model says; None where it has no value of its own, as the null model."""
    model_uncertainty: float | None = None
    """One standard deviation of the model file; None where it states none."""
    sigmas: float | None = None
    """The refit less the model, in standard deviations of the difference."""
    pull_sigma: float | None = None
    """The refit less what the dataset states, in standard deviations of the latter."""
    seen: bool = True
    """Whether a reading depends on it: else the fit left it where it began."""

    def sentence(self) -> str:
        """In words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        if self.refit_uncertainty is None:
            return f"fixed: {self.name} = {self.refit:.6g}{unit}"
        if not self.seen:
            return (
                f"not fitted: {self.name} = {self.refit:.6g}{unit}, where the fit began: no reading depends"
                " on it"
            )
        fitted = f"{with_uncertainty(self.refit, self.refit_uncertainty)}{unit}"
        pull = "" if self.pull_sigma is None else f" ({spelt_sigmas(self.pull_sigma)} from what is stated)"
        if self.model is None or self.sigmas is None:
            return f"fitted: {self.name} = {fitted}{pull}"
        stated = with_uncertainty(self.model, self.model_uncertainty)
        return f"refitted: {self.name} = {fitted}; the model says {stated}: {spelt_sigmas(self.sigmas)} apart"

    def as_json(self) -> ComparedNumber:
        """As it stands in the JSON answer; JSON has no infinity, which is written as text."""
        return {
            "name": self.name,
            "unit": self.unit,
            "model": _plain(self.model),
            "model_uncertainty": _plain(self.model_uncertainty),
            "refit": _plain(self.refit),
            "refit_uncertainty": _plain(self.refit_uncertainty),
            "sigmas": _plain(self.sigmas),
            "fixed": self.refit_uncertainty is None,
        }


@dataclass(frozen=True)
class ComparedValues:
    """All values of a model beside those of a refit, and whether the two contradict each other."""

    each: tuple[ComparedValue, ...]
    p: float | None
    """p value of the distance between the two, if both were of one needle; None without a model's values."""

    @property
    def contradict(self) -> bool:
        """Whether the model's values are not those of these data."""
        return self.p is not None and self.p < CONTRADICTS

    def worst(self) -> ComparedValue | None:
        """The value that is farthest off; None without a model's values."""
        told = [value for value in self.each if value.sigmas is not None]
        return max(told, key=lambda value: abs(value.sigmas or 0.0), default=None)

    def sentence(self) -> str:
        """Whether the model's values hold, in words; empty without them."""
        worst = self.worst()
        if self.p is None or worst is None:
            return ""
        spelt = spelt_p(self.p)
        if not self.contradict:
            return f"the model's values hold on these data ({spelt}, limit {CONTRADICTS:g})"
        return (
            f"the model's values contradict these data ({spelt}, limit {CONTRADICTS:g}):"
            f" {worst.name} is off by {spelt_sigmas(worst.sigmas or 0.0)}"
        )

    def sentences(self) -> list[str]:
        """Whether the model's values hold, and each value."""
        said = self.sentence()
        return [*([said] if said else []), *(value.sentence() for value in self.each)]

    def fitted(self) -> dict[str, FittedNumber]:
        """What the refit found, by name."""
        free: dict[str, FittedNumber] = {}
        for value in self.each:
            free[value.name] = {
                "value": value.refit,
                "unit": value.unit,
                "uncertainty": _plain(value.refit_uncertainty),
            }
            if value.pull_sigma is not None:
                free[value.name]["pull_sigma"] = value.pull_sigma
        return free


def spelt_p(p: float) -> str:
    """A p value in words; one of 0 is below what a tail is known to."""
    return f"p = {p:.2g}" if p > LEAST_P else f"p < {LEAST_P:g}"


def spelt_sigmas(sigmas: float) -> str:
    """How far two things are apart, without a sign; beyond `FARTHEST_SIGMAS` no figure is given."""
    if abs(sigmas) > FARTHEST_SIGMAS:
        return f"more than {FARTHEST_SIGMAS:g}σ"
    return f"{abs(sigmas):.1f}σ"


def compared_values(
    parameters: Sequence[FreeParameter],
    refit: Gaussian,
    model: Gaussian | None,
    fixed: Collection[str],
    pull_rigidity: float | None,
    unseen: Collection[str] = (),
) -> ComparedValues:
    """Values of the shared parameters (p,) of a refit beside those of the model, by name in the order of x.

    A model's value without an uncertainty is taken as it stands: the distance then is in those of the refit.
    `pull_rigidity` is None where no rigidity is stated; no reading depends on those `unseen`.
    """
    names, units = shared_names(parameters), shared_units(parameters)
    at, deviations = _told(parameters, refit)
    known = _told(parameters, model) if model is not None else None
    away = np.zeros(len(names)) if model is None else refit.mean - model.mean
    spread = refit.covariance if model is None else refit.covariance + model.covariance
    # a scale may run the other way, as that of a compliance given as a stiffness
    way = 1.0 if known is None else np.where((at - known[0]) * away < 0.0, -1.0, 1.0)
    size = np.sqrt(np.diag(spread))
    # one that no reading sees stays where it began: it is no distance away
    distances = np.divide(way * away, size, out=np.zeros(len(names)), where=size > 0.0)
    each = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        free = name not in fixed
        each.append(
            ComparedValue(
                name,
                unit,
                float(at[i]),
                float(deviations[i]) if free else None,
                None if known is None else float(known[0][i]),
                None if known is None else float(known[1][i]) or None,
                float(distances[i]) if known is not None and free else None,
                pull_rigidity if i == 1 and model is None else None,
                name not in unseen,
            )
        )
    moving = [i for i, name in enumerate(names) if name not in fixed and size[i] > 0.0]
    p = None
    if model is not None and moving:
        alike = spread[np.ix_(moving, moving)] / np.outer(size[moving], size[moving])
        apart = away[moving] / size[moving]
        p = float(chdtrc(len(moving), apart @ np.linalg.pinv(alike, hermitian=True) @ apart))
    return ComparedValues(tuple(each), p)


def with_uncertainty(value: float, uncertainty: float | None) -> str:
    """A value with its standard deviation, both to the second digit of the latter."""
    if uncertainty is None:
        return f"{value:.6g}"
    if not 0.0 < uncertainty < math.inf or not math.isfinite(value):
        return f"{value:.6g} ± {uncertainty:.2g}"
    decimals = min(MOST_DECIMALS, max(0, 1 - math.floor(math.log10(uncertainty))))
    return f"{value:.{decimals}f} ± {uncertainty:.{decimals}f}"


def _told(parameters: Sequence[FreeParameter], of: Gaussian) -> tuple[Array, Array]:
    """Values and standard deviations (p,) in the units of files."""
    at = within_bounds(parameters, of.mean)
    return in_file_units(parameters, at), deviations_in_file_units(parameters, at, of.deviations)


def _plain(value: float | None) -> float | str | None:
    if value is None or math.isnan(value):
        return None
    return value if math.isfinite(value) else str(value)
