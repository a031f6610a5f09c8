"""Models' readings of binned trials; what was solved lately is kept."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np

from needle_rig.errors import SolverError
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Reading, Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Rod
from needle_rig.physics.solver import Solution, solve_batch
from needle_rig.workbench.observations.binning import BinnedTrial

Key = tuple[tuple[Effect, ...], float, float, float, int]
"""(effects that move the needle, torsional rigidity, friction, element length, identity of the trial)"""

CACHE_ENTRIES = 1500


class Simulator:
    """Solves models side by side, each pair of what moves the needle and of a trial once.

    A trial is known by its identity, with the path that drives it; it is kept with its solutions. Sent to
    another process, a simulator has nothing kept.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[Key, tuple[Trial, Solution]] = OrderedDict()

    def __reduce__(self) -> tuple[type[Simulator], tuple[()]]:
        return Simulator, ()

    # a law far out may overflow: values that are not finite are refused where they are used, in words
    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def readings(
        self, models: Sequence[NeedleModel], trials: Sequence[BinnedTrial], most_solves: float = math.inf
    ) -> list[Array]:
        """Bin means (C, K; N·m and rad) that each model gives in the trial at its place.

        Models that differ in what the sensors make of it share one solution. Raises SolverError, also where a
        trial took more than `most_solves` solves a sample, and BadInput.
        """
        keys = [_key(model, binned.trial) for model, binned in zip(models, trials, strict=True)]
        new: OrderedDict[Key, int] = OrderedDict()
        for place, key in enumerate(keys):
            if key not in self._kept:
                new.setdefault(key, place)
        rods: list[Rod] = []
        inputs: list[tuple[Array, Array, Array | None]] = []
        for place in new.values():
            drive = trials[place].trial
            rods.append(models[place].rod(drive))
            inputs.append((drive.time_s, models[place].held_path(drive)[0], drive.tip_torque_nm))
        solved = []
        if rods:  # processes share the cores
            solved = solve_batch(rods, inputs, threads=1, most_solves_per_sample=most_solves)
        for (key, place), solution in zip(new.items(), solved, strict=True):
            self._kept[key] = trials[place].trial, solution
        solutions = [self._kept[key][1] for key in keys]
        if any(s.solves > most_solves * s.time_s.size for s in solutions):
            raise SolverError(f"{models[0].name}: the needle snaps through too many balances to follow")
        readings = [
            binned.averaged(_stacked(model.observed(binned.trial, solution)))
            for model, binned, solution in zip(models, trials, solutions, strict=True)
        ]
        while len(self._kept) > CACHE_ENTRIES:
            self._kept.popitem(last=False)
        return readings


def _key(model: NeedleModel, trial: Trial) -> Key:
    moving = tuple(e for e in model.effects if not e.is_off() and _moves(e))
    return moving, model.torsional_rigidity_nm2, model.friction_n, model.element_length_m, id(trial)


def _moves(effect: Effect) -> bool:
    return any(effect.has(hook) for hook in ("shape", "torque", "drive"))


def _stacked(reading: Reading) -> Array:
    return np.vstack([reading.torque_nm[None, :], reading.hall_rad.T])
