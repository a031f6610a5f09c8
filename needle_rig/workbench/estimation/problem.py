"""A dataset made ready for fits: bins, noise, whitened residuals for any parameters; and what a fit found."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.workbench.estimation.parameters import (
    FreeParameter,
    free_parameters,
    make_effects,
    shared_names,
)
from needle_rig.workbench.estimation.simulator import Simulator
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.noise import Noise, Whitener, replicate_groups, whitener
from needle_rig.workbench.observations.noise_terms.term import Places

FRICTION_SCALE_N = 1e-3
EXACT = 1e-4
"""Standard deviation, of a logarithm or a scaled value, of what is fixed or stated as exact."""


@dataclass(frozen=True)
class ParameterVector:
    """Values of all parameters: logarithms of friction (N) and torsional rigidity (N·m²), scaled values of
    the effects' free parameters (k,), and each trial's random effect: log of its friction over the common one
    (T,)."""

    log_friction: float
    log_rigidity: float
    scaled_values: Array
    trial_friction: Array

    @property
    def shared(self) -> Array:
        """What all trials share (p,): friction, rigidity, scaled values."""
        return np.concatenate([[self.log_friction, self.log_rigidity], self.scaled_values])


@dataclass(frozen=True, eq=False)
class Problem:
    """What every fit needs; it can be sent to another process.

    Without `whiteners` these are made of the noise and the trials; without `nuisance` there is none.
    """

    name: str
    base: NeedleModel
    """Geometry and stated constants, without the effects that are fitted."""
    library: Mapping[str, type[Effect]]
    trials: tuple[BinnedTrial, ...]
    noise: Noise
    rigidity_prior: float
    """Relative standard deviation of the stated torsional rigidity."""
    nuisance: tuple[Array, ...] = ()
    """Directions (n, q) a trial, whitened, each with a coefficient of prior standard deviation 1."""
    whiteners: tuple[Whitener, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Shared parameters that no fit moves, by name: a logarithm, or a scaled value."""
    simulator: Simulator = field(default_factory=Simulator, repr=False)

    def __post_init__(self) -> None:
        if not self.whiteners:
            object.__setattr__(self, "whiteners", tuple(whitener(self.noise, b) for b in self.trials))
        if not self.nuisance:
            none = tuple(np.zeros((w.channel.size, 0)) for w in self.whiteners)
            object.__setattr__(self, "nuisance", none)

    def with_noise(self, noise: Noise) -> Problem:
        """The same data under other noise; nuisance directions are dropped."""
        return dataclasses.replace(self, noise=noise, whiteners=(), nuisance=())

    def over(self, trials: Sequence[BinnedTrial]) -> Problem:
        """Other trials; nuisance directions are dropped."""
        return dataclasses.replace(self, trials=tuple(trials), whiteners=(), nuisance=())

    def with_effects(self, *effects: type[Effect]) -> Problem:
        """The same, with further effects in its library."""
        return dataclasses.replace(self, library={**self.library, **{e.name(): e for e in effects}})

    def with_means(self, means: Sequence[Array]) -> Problem:
        """Other bin means (C, K) where there are data, under the noise of these."""
        trials = (
            dataclasses.replace(b, mean=np.where(np.isfinite(b.mean), m, np.nan))
            for b, m in zip(self.trials, means, strict=True)
        )
        return dataclasses.replace(self, trials=tuple(trials))

    @property
    def groups(self) -> list[list[int]]:
        """Trials by command."""
        return replicate_groups([b.command for b in self.trials])

    @cached_property
    def recorded(self) -> Places:
        """The place (T,) of each trial's recorded trial: blocks of one have one friction."""
        return np.unique([b.trial.index for b in self.trials], return_inverse=True)[1]

    @property
    def size(self) -> int:
        """Number of whitened values."""
        return sum(w.channel.size for w in self.whiteners)

    def parameters(self, names: Sequence[str]) -> tuple[FreeParameter, ...]:
        """Free parameters of the named effects."""
        return free_parameters(
            self.library, names, self.base.layout, self.base.torque_scale, self._places_to_try
        )

    @cached_property
    def _places_to_try(self) -> dict[str, tuple[tuple[float, ...], ...]]:
        """By effect: the values, within bounds, of what a fit holds."""
        trials = [b.trial for b in self.trials]
        found = {}
        for name, effect in self.library.items():
            for info in effect.parameters().values():
                if info.places is not None:
                    rows = info.places(trials)
                    inside = (tuple(float(v) for v in row if info.lower <= v <= info.upper) for row in rows)
                    found[name] = tuple(row for row in dict.fromkeys(inside) if row)
        return found

    def candidates(self, present: Container[str]) -> tuple[str, ...]:
        """Effects of the library that are not `present` and have a size in this layout, sorted by name.

        One with a size for each Hall sensor has none where the layout has no sensor.
        """
        sizes = (p.effect for p in self.parameters(sorted(self.library)) if not p.info.shapes)
        return tuple(name for name in dict.fromkeys(sizes) if name not in present)

    def model(
        self, parameters: Sequence[FreeParameter], vector: ParameterVector, trial: int | None = None
    ) -> NeedleModel:
        """The model at `vector`, with the friction of a trial (its place) or the common one."""
        effects = make_effects(self.library, parameters, vector.scaled_values)
        if trial is not None:
            effects = (*effects, FrictionOfTrial(float(np.exp(vector.trial_friction[trial]))))
        return dataclasses.replace(
            self.base,
            torsional_rigidity_nm2=float(np.exp(vector.log_rigidity)),
            friction_n=float(np.exp(vector.log_friction)),
            effects=effects,
        )

    def fixed_places(self, parameters: Sequence[FreeParameter], scaled_values: Array) -> dict[int, float]:
        """What is fixed, by its place among the shared parameters; what is held stands at `scaled_values`
        (k,)."""
        fixed = {k: self.fixed[n] for k, n in enumerate(shared_names(parameters)) if n in self.fixed}
        held = {2 + k: float(scaled_values[k]) for k, a in enumerate(parameters) if a.held}
        return {**held, **fixed}

    def fixing(self, values: Mapping[str, float]) -> Problem:
        """The same with further shared parameters fixed."""
        return dataclasses.replace(self, fixed={**self.fixed, **values})

    def lumps_friction(self, parameters: Sequence[FreeParameter]) -> bool:
        """Whether some friction among these effects does not grow with that of the tissue."""
        scale_n = FRICTION_SCALE_N * self.base.torque_scale
        try:
            effects = make_effects(
                self.library, parameters, np.array([np.clip(1.0, *a.bounds) for a in parameters])
            )
            model = dataclasses.replace(self.base, friction_n=scale_n, effects=effects)
            rods = [
                m.rod(self.trials[0].trial)
                for m in (
                    dataclasses.replace(model, friction_n=2.0 * scale_n),
                    model.with_effects(FrictionOfTrial(2.0)),
                )
            ]
        except BadInput:
            return True
        one, other = (np.r_[r.slip_plus_nm, r.slip_minus_nm] for r in rods)
        return not np.allclose(one, other, rtol=1e-9, atol=0.0)

    def readings(
        self,
        models: Sequence[NeedleModel],
        trials: Sequence[int],
        friction_factors: Sequence[float] | Array | None = None,
        most_solves: float = math.inf,
    ) -> list[Array]:
        """Bin means (C, K) that each model gives in the trial at its place; see `Simulator.readings`."""
        return self.simulator.readings(
            models, [self.trials[t] for t in trials], friction_factors, most_solves
        )

    def predict(
        self, parameters: Sequence[FreeParameter], vector: ParameterVector, most_solves: float = math.inf
    ) -> list[Array]:
        """Bin means (C, K; N·m and rad) of every trial at its random effect. Raises SolverError, BadInput."""
        every = range(len(self.trials))
        models = [self.model(parameters, vector)] * len(self.trials)
        return self.readings(models, every, np.exp(vector.trial_friction), most_solves)

    def sketched(
        self,
        parameters: Sequence[FreeParameter],
        vector: ParameterVector,
        more: Sequence[FreeParameter],
        others: Sequence[ParameterVector],
    ) -> list[Array]:
        """Bin means (C, K, V) of every trial at V vectors `others` with `more` parameters, roughly; see
        `Simulator.sketched`."""
        models = [self.model(more, other) for other in others]
        factors = np.exp(vector.trial_friction)
        return self.simulator.sketched(self.model(parameters, vector), models, self.trials, factors)

    def near(
        self,
        parameters: Sequence[FreeParameter],
        vector: ParameterVector,
        others: Sequence[ParameterVector],
        most_solves: float = math.inf,
    ) -> list[list[Array] | None]:
        """Bin means (C, K) of every trial at vectors near `vector`; see `Simulator.near`."""
        return self.simulator.near(
            self.model(parameters, vector),
            np.exp(vector.trial_friction),
            [(self.model(parameters, other), np.exp(other.trial_friction)) for other in others],
            self.trials,
            most_solves,
        )

    def residuals(self, readings: Sequence[Array], trials: Sequence[int]) -> list[Array]:
        """Whitened data minus model (n,) for each reading."""
        return [self.whiteners[t](self.trials[t].mean - r) for r, t in zip(readings, trials, strict=True)]

    def raw(self, residuals: Sequence[Array]) -> list[Array]:
        """Bin means (C, K, …), a trial each, that whiten to `residuals` (n, …); NaN where nothing was read.

        Of a fit's residuals: data minus model at the trials' random effects and the nuisances' coefficients.
        """
        found = []
        for binned, whitening, values in zip(self.trials, self.whiteners, residuals, strict=True):
            means = np.full((*binned.mean.shape, *values.shape[1:]), np.nan)
            known = whitening.raw(values)
            means[:, : known.shape[1]] = known
            found.append(means)
        return found


@dataclass(frozen=True)
class Fit:
    """A minimum. T trials, p shared parameters (friction, rigidity, then k scaled values), q nuisances."""

    effects: tuple[str, ...]
    parameters: tuple[FreeParameter, ...]
    vector: ParameterVector
    nuisance: Array
    objective: float
    """−2 log posterior with its log-determinants, up to a constant shared by all fits of a problem."""
    chi2: float
    """Sum of squared whitened residuals."""
    pull_rigidity: float
    """Rigidity's distance from its stated value in prior standard deviations."""
    scatter: float
    """Relative scatter of friction from trial to trial, estimated by this fit."""
    scatter_dof: float
    """Degrees of freedom of `scatter`, those of its prior included."""
    covariance: Array
    """Covariance of the shared parameters (p, p), all others marginalised."""
    residuals: tuple[Array, ...]
    jacobians: tuple[Array, ...]
    """Derivatives of the whitened model (n, p + 1) a trial; the last column is the trial's random effect."""
    rank: int
    """Directions of the effects' parameters that the data see with all other parameters projected out; of
    those whose size no prior states. The others are paid for by `ln det` of what is learnt of them."""
    converged: bool

    @property
    def scaled_errors(self) -> Array:
        """Standard deviation of each scaled value (k,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance)[2:], 0.0))
