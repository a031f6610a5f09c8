"""Models' readings of binned trials; what was solved lately is kept."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np

from needle_rig.errors import SolverError
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Rod
from needle_rig.physics.solver import Path, Sampled, solve_series
from needle_rig.workbench.observations.binning import BinnedTrial

Key = tuple[tuple[Effect, ...], float, float, float, float, int]
"""(effects that move the needle, torsional rigidity, friction, element length, factor on friction, identity
of the trial)"""

CACHE_ENTRIES = 1500


class Simulator:
    """Solves models side by side, each pair of what moves the needle and of a trial once.

    A trial is known by its identity, with the path that drives it; it is kept with its solutions. Sent to
    another process, a simulator has nothing kept.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[Key, tuple[Trial, Sampled]] = OrderedDict()
        self._paths: OrderedDict[int, tuple[Trial, Path]] = OrderedDict()

    def __reduce__(self) -> tuple[type[Simulator], tuple[()]]:
        return Simulator, ()

    # a law far out may overflow: values that are not finite are refused where they are used, in words
    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def readings(
        self,
        models: Sequence[NeedleModel],
        trials: Sequence[BinnedTrial],
        friction_factors: Sequence[float] | Array | None = None,
        most_solves: float = math.inf,
    ) -> list[Array]:
        """Bin means (C, K; N·m and rad) that each model gives in the trial at its place.

        `friction_factors` (trials,) multiply every slip limit in the trial at their place; default 1. Models
        that differ in what the sensors make of it share one solution; trials of one model object are solved
        in one call. Raises SolverError, also where a trial took more than `most_solves` solves a sample, and
        BadInput.
        """
        factors = np.ones(len(trials)) if friction_factors is None else np.asarray(friction_factors, float)
        places: dict[int, list[int]] = {}
        for place, model in enumerate(models):
            places.setdefault(id(model), []).append(place)
        found: list[Array] = [np.empty(0)] * len(trials)
        for of_model in places.values():
            model = models[of_model[0]]
            solved = self._solved(model, [trials[k].trial for k in of_model], factors[of_model], most_solves)
            observes = bool(model.acting("observe"))
            for k, sampled in zip(of_model, solved, strict=True):
                torque_nm, hall_rad = sampled.torque_nm, sampled.sensor_rad
                if observes:
                    seen = model.observed(trials[k].trial, sampled)
                    torque_nm, hall_rad = seen.torque_nm, seen.hall_rad
                found[k] = trials[k].averaged(np.vstack([torque_nm[None, :], hall_rad.T]))
        while len(self._kept) > CACHE_ENTRIES:
            self._kept.popitem(last=False)
        return found

    def _solved(
        self, model: NeedleModel, trials: Sequence[Trial], factors: Array, most_solves: float
    ) -> list[Sampled]:
        """What the needle does in trials of one model; those not kept are solved in one call a rod."""
        moving = _moving(model)
        keys = [(*moving, float(f), id(t)) for f, t in zip(factors, trials, strict=True)]
        new = list({key: k for k, key in enumerate(keys) if key not in self._kept}.values())
        driven = bool(model.acting("drive"))
        of_rod: dict[int, tuple[Rod, list[int]]] = {}
        for k, rod in zip(new, model.rods([trials[k] for k in new]), strict=True):
            of_rod.setdefault(id(rod), (rod, []))[1].append(k)
        for rod, which in of_rod.values():
            paths = [self._path(trials[k]) for k in which]
            if driven:
                held = [model.held_path(trials[k])[0] for k in which]
                paths = [
                    Path.of(path.time_s, base_rad, path.tip_nm if path.tip_nm.size else None)
                    for path, base_rad in zip(paths, held, strict=True)
                ]
            solved = solve_series(rod, paths, factors[which], most_solves_per_sample=most_solves)
            for k, sampled in zip(which, solved, strict=True):
                self._kept[keys[k]] = trials[k], sampled
        found = [self._kept[key][1] for key in keys]
        if any(s.solves > most_solves * s.torque_nm.size for s in found):
            raise SolverError(f"{model.name}: the needle snaps through too many balances to follow")
        return found

    def _path(self, trial: Trial) -> Path:
        """A trial's path, checked once."""
        if id(trial) not in self._paths:
            path = Path.of(trial.time_s, trial.base_angle_rad, trial.tip_torque_nm)
            self._paths[id(trial)] = trial, path
            if len(self._paths) > CACHE_ENTRIES:
                self._paths.popitem(last=False)
        return self._paths[id(trial)][1]


def _moving(model: NeedleModel) -> tuple[tuple[Effect, ...], float, float, float]:
    """What moves the needle of a model."""
    moving = tuple(e for e in model.effects if _moves(e) and not e.is_off())
    return moving, model.torsional_rigidity_nm2, model.friction_n, model.element_length_m


def _moves(effect: Effect) -> bool:
    return any(effect.has(hook) for hook in ("shape", "torque", "drive"))
