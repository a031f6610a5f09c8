"""A dataset made ready for fits: bins, noise, and the model's whitened residuals for any parameters."""

from __future__ import annotations

import dataclasses
import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from needle_rig.errors import BadInput, SolverError
from needle_rig.physics.effect import Effect, Reading
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Rod
from needle_rig.physics.solver import Solution, solve_batch
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.workbench.estimation.parameters import Coordinate, coordinates, make_effects
from needle_rig.workbench.observations.binning import BinnedTrial
from needle_rig.workbench.observations.noise import Noise, Whitener, replicate_groups, whitener

Array = npt.NDArray[np.float64]

FRICTION_SCALE_N = 1e-3
CACHE_ENTRIES = 1500


@dataclass(frozen=True)
class Point:
    """Values of all parameters: logarithms of friction (N) and torsional rigidity (N·m²), positions of the
    effects' coordinates (k,), and each trial's own logarithm of its friction over the common one (T,)."""

    log_friction: float
    log_rigidity: float
    positions: Array
    trial_friction: Array


@dataclass
class Problem:
    """What every fit needs; it can be sent to another process."""

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
    threads: int | None = 1
    whiteners: tuple[Whitener, ...] = ()
    _cache: OrderedDict[object, Solution] = field(default_factory=OrderedDict, repr=False)

    def __post_init__(self) -> None:
        if not self.whiteners:
            self.whiteners = tuple(whitener(self.noise, b) for b in self.trials)
        if not self.nuisance:
            self.nuisance = tuple(np.zeros((w.channel.size, 0)) for w in self.whiteners)

    def __getstate__(self) -> dict[str, object]:
        return self.__dict__ | {"_cache": OrderedDict()}

    def with_noise(self, noise: Noise) -> Problem:
        """The same data under other noise; nuisance directions are dropped."""
        return dataclasses.replace(self, noise=noise, whiteners=(), nuisance=(), _cache=self._cache)

    @property
    def groups(self) -> list[list[int]]:
        """Trials by command."""
        return replicate_groups([b.command for b in self.trials])

    @property
    def size(self) -> int:
        """Number of whitened values."""
        return sum(w.channel.size for w in self.whiteners)

    def axes(self, names: Sequence[str]) -> tuple[Coordinate, ...]:
        """Coordinates of the named effects."""
        return coordinates(self.library, names, self.base.layout)

    def model(self, axes: Sequence[Coordinate], point: Point, trial: int | None = None) -> NeedleModel:
        """The model at `point`, with the friction of `trial` or the common one."""
        effects = make_effects(self.library, axes, point.positions)
        if trial is not None:
            effects = (*effects, FrictionOfTrial(float(np.exp(point.trial_friction[trial]))))
        return dataclasses.replace(
            self.base,
            torsional_rigidity_nm2=float(np.exp(point.log_rigidity)),
            friction_n=float(np.exp(point.log_friction)),
            effects=effects,
        )

    def lumps_friction(self, axes: Sequence[Coordinate]) -> bool:
        """Whether some friction among these effects does not grow with that of the tissue."""
        try:
            effects = make_effects(self.library, axes, np.array([np.clip(1.0, *a.bounds) for a in axes]))
            model = dataclasses.replace(self.base, friction_n=FRICTION_SCALE_N, effects=effects)
            rods = [
                m.rod(self.trials[0].trial)
                for m in (
                    dataclasses.replace(model, friction_n=2.0 * FRICTION_SCALE_N),
                    model.with_effects(FrictionOfTrial(2.0)),
                )
            ]
        except BadInput:
            return True
        one, other = (np.r_[r.slip_plus_nm, r.slip_minus_nm] for r in rods)
        return not np.allclose(one, other, rtol=1e-9, atol=0.0)

    def readings(
        self, models: Sequence[NeedleModel], trials: Sequence[int], most_solves: float = math.inf
    ) -> list[Array]:
        """Bin means (C, K) that each model gives in each trial, solved side by side.

        Models that differ in what the sensors make of it share one solution. Raises SolverError, also where a
        trial took more than `most_solves` solves a sample.
        """
        keys: list[object] = []
        new: OrderedDict[object, int] = OrderedDict()
        for place, (model, trial) in enumerate(zip(models, trials, strict=True)):
            acting = tuple(e for e in model.effects if not e.is_off() and _moves(e))
            key: object = (
                acting,
                model.torsional_rigidity_nm2,
                model.friction_n,
                model.element_length_m,
                trial,
            )
            keys.append(key)
            if key not in self._cache and key not in new:
                new[key] = place
        rods: list[Rod] = []
        inputs: list[tuple[Array, Array]] = []
        for place in new.values():
            drive = self.trials[trials[place]].trial
            rods.append(models[place].rod(drive))
            inputs.append((drive.time_s, models[place].held_path(drive)[0]))
        solved = solve_batch(rods, inputs, threads=self.threads) if rods else []
        self._cache.update(zip(new, solved, strict=True))
        if any(self._cache[k].solves > most_solves * self._cache[k].time_s.size for k in keys):
            raise SolverError(f"{models[0].name}: the needle snaps through too many balances to follow")
        found = []
        for which, model, trial in zip(keys, models, trials, strict=True):
            binned = self.trials[trial]
            reading = model.observed(binned.trial, self._cache[which])
            found.append((binned.average @ _stack(reading).T).T)
        while len(self._cache) > CACHE_ENTRIES:
            self._cache.popitem(last=False)
        return found

    def residuals(self, readings: Sequence[Array], trials: Sequence[int]) -> list[Array]:
        """Whitened data minus model (n,) for each reading."""
        return [self.whiteners[t](self.trials[t].mean - r) for r, t in zip(readings, trials, strict=True)]


def _moves(effect: Effect) -> bool:
    return any(effect.has(hook) for hook in ("shape", "torque", "drive"))


def _stack(reading: Reading) -> Array:
    return np.vstack([reading.torque_nm[None, :], reading.hall_rad.T])
