"""One question asked three ways: friction, torsional rigidity and stiffness from the same traces.

What a person types is what runs here: `fit_peers` counts these lines and shows them. lmfit and
Sherpa get the predictor of needle-rig as a plain function, every sample, and the noise that the sensors have.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import needle_rig as nr
from needle_rig.dataset import Dataset
from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.physics.effects.tissue_elasticity import TissueElasticity
from needle_rig.units import deg, nmm

FRICTION, RIGIDITY = "friction_nmm_per_100mm", "torsional_rigidity_nmm2"
STIFFNESS = "tissue_elasticity.stiffness_nmm_per_rad_per_100mm"
NAMES = (FRICTION, RIGIDITY, STIFFNESS)
MODEL = load_parameters("rig_rigid").with_effects(TissueElasticity(0.35))
TORQUE_NMM, HALL_DEG = 0.0008, 0.25
"""Standard deviation of a sample of the simulated sensors: what a data sheet says."""


@dataclass(frozen=True)
class Said:
    """Value and standard deviation of each parameter; NaN where there is none."""

    values: Array
    sigmas: Array
    intervals: Array
    """95 %, (3, 2)."""
    redchi: float
    report: str


# -- the plain function --------------------------------------------------------------------------------------


def shaft(trials: Any, friction: float, rigidity: float, stiffness: float = np.inf) -> Array:
    model = MODEL.replaced({FRICTION: friction, RIGIDITY: rigidity, STIFFNESS: stiffness})
    read = [model.predict(given.trial) for given in trials]
    return np.concatenate([np.column_stack([nmm(r.torque_nm), deg(r.hall_rad)]).ravel() for r in read])


def samples(trials: Any) -> tuple[Array, Array]:
    both = [np.column_stack([nmm(given.torque_nm), deg(given.hall_rad)]) for given in trials]
    sigma = np.concatenate([np.broadcast_to([TORQUE_NMM] + 4 * [HALL_DEG], of.shape).ravel() for of in both])
    return np.concatenate([of.ravel() for of in both]), sigma


# -- the ways ------------------------------------------------------------------------------------------------


def needle_rig(data: Dataset, missing: bool) -> Any:
    return nr.fit(data, effects=[] if missing else ["tissue_elasticity"])


def lmfit(data: Dataset, missing: bool) -> Any:
    from lmfit import Parameters, minimize

    readings, sigma = samples(data.trials)
    params = Parameters()
    params.add("friction", value=0.08, min=0.001)
    params.add("rigidity", value=60, min=1)
    if not missing:
        params.add("stiffness", value=0.2, min=0.02)
    return minimize(lambda p: (shaft(data.trials, **p.valuesdict()) - readings) / sigma, params)


def lmfit_by_trial(data: Dataset, missing: bool) -> Any:
    from lmfit import Parameters, minimize

    readings, sigma = samples(data.trials)

    def residual(params: Any) -> Array:
        values = params.valuesdict()
        model = [
            shaft([given], values[f"friction_{k}"], values["rigidity"], values.get("stiffness", np.inf))
            for k, given in enumerate(data.trials)
        ]
        return (np.concatenate(model) - readings) / sigma

    params = Parameters()
    for k in range(len(data.trials)):
        params.add(f"friction_{k}", value=0.08, min=0.001)
    params.add("rigidity", value=60, min=1)
    if not missing:
        params.add("stiffness", value=0.2, min=0.02)
    return minimize(residual, params, scale_covar=False)


def sherpa(data: Dataset, missing: bool) -> Any:
    from sherpa.data import Data1D
    from sherpa.fit import Fit
    from sherpa.models.model import ArithmeticModel
    from sherpa.models.parameter import Parameter

    class Shaft(ArithmeticModel):  # type: ignore[misc]
        def __init__(self, name: str = "shaft") -> None:
            self.friction = Parameter(name, "friction", 0.08, min=0.001)
            self.rigidity = Parameter(name, "rigidity", 60, min=1)
            self.stiffness = Parameter(name, "stiffness", 0.2, min=0.02)
            constants = (self.friction, self.rigidity)
            super().__init__(name, constants if missing else (*constants, self.stiffness))

        def calc(self, p: Any, x: Any, *args: Any, **kwargs: Any) -> Array:
            return shaft(data.trials, *p)

    readings, sigma = samples(data.trials)
    model = Shaft()
    fit = Fit(Data1D("readings", np.arange(readings.size), readings, staterror=sigma), model)
    return fit.fit(), fit


# -- their answers -------------------------------------------------------------------------------------------

SIGMAS_95 = 1.96


def _normal(values: Any, sigmas: Any, redchi: float, report: str) -> Said:
    """A way that gives ± alone; a parameter that was not fitted is NaN."""
    value, sigma = np.full(len(NAMES), np.nan), np.full(len(NAMES), np.nan)
    value[: len(values)], sigma[: len(sigmas)] = values, sigmas
    return Said(value, sigma, value[:, None] + SIGMAS_95 * np.outer(sigma, [-1.0, 1.0]), redchi, report)


def _of_needle_rig(found: Any) -> Said:
    params = [found.params.get(name) for name in NAMES]
    value = np.array([np.nan if p is None else p.value for p in params])
    sigma = np.array([np.nan if p is None else p.stderr for p in params])
    ends = [(np.nan, np.nan) if p is None else p.interval for p in params]
    return Said(value, sigma, np.array(ends), found.redchi, found.report())


def _of_lmfit(found: Any) -> Said:
    from lmfit import fit_report

    params = [found.params[name] for name in ("friction", "rigidity", "stiffness") if name in found.params]
    values, sigmas = [p.value for p in params], [p.stderr or np.nan for p in params]
    return _normal(values, sigmas, found.redchi, fit_report(found))


def _of_lmfit_by_trial(found: Any) -> Said:
    from lmfit import fit_report

    # the mean of the trials, whose ± is the scatter over √8
    frictions = [p.value for name, p in found.params.items() if name.startswith("friction_")]
    params = [found.params[name] for name in ("rigidity", "stiffness") if name in found.params]
    spread = float(np.std(frictions, ddof=1) / np.sqrt(len(frictions)))
    return _normal(
        [float(np.mean(frictions)), *(p.value for p in params)],
        [spread, *(p.stderr or np.nan for p in params)],
        found.redchi,
        fit_report(found),
    )


def _of_sherpa(answered: Any) -> Said:
    found, fit = answered
    errors = fit.est_errors()
    sigmas = [np.nan if high is None else high for high in errors.parmaxes]
    return _normal(errors.parvals, sigmas, found.rstat, f"{found.format()}\n{errors.format()}")


@dataclass(frozen=True)
class Way:
    """A way of asking."""

    name: str
    ask: Callable[[Dataset, bool], Any]
    read: Callable[[Any], Said]
    shared: tuple[Callable[..., Any], ...] = ()
    """What must be typed beside it."""

    def source(self) -> str:
        """What is typed."""
        return "\n\n\n".join(inspect.getsource(each).rstrip() for each in (*self.shared, self.ask))

    def lines(self) -> int:
        """How many lines of it hold something."""
        return sum(bool(line.strip()) for line in self.source().splitlines())


WAYS = (
    Way("needle-rig", needle_rig, _of_needle_rig),
    Way("lmfit", lmfit, _of_lmfit, (shaft, samples)),
    Way("Sherpa", sherpa, _of_sherpa, (shaft, samples)),
    Way("lmfit, a friction for each trial", lmfit_by_trial, _of_lmfit_by_trial, (shaft, samples)),
)
