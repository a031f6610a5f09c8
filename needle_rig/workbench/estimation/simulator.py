"""Models' readings of binned trials; what was solved lately is kept."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np

from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Reading, Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Rod
from needle_rig.physics.solution import Path, Sampled
from needle_rig.physics.solver import in_reach, solve_series
from needle_rig.workbench.observations.binning import BinnedTrial

Key = tuple[tuple[Effect, ...], float, float, float, bytes, float, int]
"""(effects in the needle, torsional rigidity, friction, element length, its held end's path where that is not
the base's, factor on friction, identity of the trial)"""

CACHE_ENTRIES = 1500
TURNING = 0.05
"""Share of a path's largest step from which the base counts as turning: slopes over less are rounding."""


class Simulator:
    """Solves models side by side, each pair of what moves the needle and of a trial once.

    A trial is known by its identity, with the path that drives it; it is kept with its solutions. Sent to
    another process, a simulator has nothing kept.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[Key, tuple[Trial, Sampled]] = OrderedDict()
        self._paths: OrderedDict[int, tuple[Trial, Path]] = OrderedDict()
        self._held_paths: OrderedDict[tuple[tuple[Effect, ...], int], tuple[Trial, Path, bytes]] = (
            OrderedDict()
        )

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
            model, of_trials = models[of_model[0]], [trials[k] for k in of_model]
            solved = self._solved(model, [b.trial for b in of_trials], factors[of_model], most_solves)
            for k, means in zip(of_model, _means(model, of_trials, solved), strict=True):
                found[k] = means
        while len(self._kept) > CACHE_ENTRIES:
            self._kept.popitem(last=False)
        return found

    # as in `readings`
    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def near(
        self,
        model: NeedleModel,
        friction_factors: Array,
        others: Sequence[tuple[NeedleModel, Array]],
        trials: Sequence[BinnedTrial],
        most_solves: float = math.inf,
    ) -> list[list[Array] | None]:
        """Bin means (C, K) in all trials that models near `model` give, each with its factors on friction.

        What moves the needle is taken to first order, by one solution for all of them; what the sensors make
        of it is exact. None for a model out of the tangent's reach. Raises SolverError, BadInput.
        """
        drives = [b.trial for b in trials]
        rod, one_rod = _one_rod(model, drives)
        reached: dict[int, Rod] = {}
        for k, (other, _) in enumerate(others):
            its_rod, its_one = _one_rod(other, drives)
            if (
                one_rod
                and its_one
                and other.acting("drive") == model.acting("drive")
                and in_reach(rod, its_rod)
            ):
                reached[k] = its_rod
        found: list[list[Array] | None] = [None] * len(others)
        if reached:
            _, *would = solve_series(
                rod,
                [self._held(model, drive)[0] for drive in drives],
                friction_factors,
                most_solves_per_sample=most_solves,
                near=[(its_rod, others[k][1]) for k, its_rod in reached.items()],
            )
            for k, sampled in zip(reached, would, strict=True):
                found[k] = _means(others[k][0], trials, sampled)
        return found

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def sketched(
        self,
        near: NeedleModel,
        models: Sequence[NeedleModel],
        trials: Sequence[BinnedTrial],
        friction_factors: Array,
        most_solves: float = math.inf,
    ) -> list[Array]:
        """Bin means (C, K, models) in each trial, roughly where a model differs from `near` in the evenness
        of its drive alone; NaN where a model cannot be solved.

        What depends on no rate goes through the same states on a path that turns back where another does, a
        little earlier or later (`_Carry`). Raises SolverError, BadInput for `near`.
        """
        found = []
        for binned, factor in zip(trials, friction_factors, strict=True):
            one = np.array([factor])
            (known,) = self._solved(near, [binned.trial], one, most_solves)
            carry = _Carry(self._held(near, binned.trial)[0], known)
            shown = []
            for model in models:
                sampled = None
                if _moving(model) == _moving(near):
                    sampled = carry.to(model.held_path(binned.trial)[0])
                try:
                    if sampled is None:
                        (sampled,) = self._solved(model, [binned.trial], one, most_solves)
                    seen = model.observed(binned.trial, sampled)
                except (SolverError, BadInput):
                    seen = Reading(binned.trial, known.torque_nm * np.nan, known.sensor_rad * np.nan)
                shown.append(np.vstack([seen.torque_nm[None, :], seen.hall_rad.T]))
            found.append(binned.averaged_all(np.stack(shown, axis=-1)))
        return found

    def _solved(
        self, model: NeedleModel, trials: Sequence[Trial], factors: Array, most_solves: float
    ) -> list[Sampled]:
        """What the needle does in trials of one model; those not kept are solved in one call a rod."""
        moving, held = _moving(model), [self._held(model, t) for t in trials]
        keys = [
            (*moving, of_path, float(f), id(t))
            for (_, of_path), f, t in zip(held, factors, trials, strict=True)
        ]
        new = list({key: k for k, key in enumerate(keys) if key not in self._kept}.values())
        of_rod: dict[int, tuple[Rod, list[int]]] = {}
        for k, rod in zip(new, model.rods([trials[k] for k in new]), strict=True):
            of_rod.setdefault(id(rod), (rod, []))[1].append(k)
        for rod, which in of_rod.values():
            paths = [held[k][0] for k in which]
            (solved,) = solve_series(rod, paths, factors[which], most_solves_per_sample=most_solves)
            for k, sampled in zip(which, solved, strict=True):
                self._kept[keys[k]] = trials[k], sampled
        found = [self._kept[key][1] for key in keys]
        if any(s.solves > most_solves * s.torque_nm.size for s in found):
            raise SolverError(f"{model.name}: the needle snaps through too many balances to follow")
        return found

    def _held(self, model: NeedleModel, trial: Trial) -> tuple[Path, bytes]:
        """Path of the needle's held end, and its bytes where it is not the base's.

        Models that drive a trial alike share its solution, whatever else they say of other trials.
        """
        effects = model.acting("drive")
        if not effects:
            return self._path(trial), b""
        kept = self._held_paths.get((effects, id(trial)))
        if kept is None:
            path, (base_rad, _) = self._path(trial), model.held_path(trial)
            of_path = b""
            if not np.array_equal(base_rad, path.base_rad):
                path = Path.of(path.time_s, base_rad, path.tip_nm if path.tip_nm.size else None)
                of_path = base_rad.tobytes()
            kept = trial, path, of_path
            self._held_paths[effects, id(trial)] = kept
            if len(self._held_paths) > CACHE_ENTRIES:
                self._held_paths.popitem(last=False)
        return kept[1:]

    def _path(self, trial: Trial) -> Path:
        """A trial's path, checked once."""
        if id(trial) not in self._paths:
            path = Path.of(trial.time_s, trial.base_angle_rad, trial.tip_torque_nm)
            self._paths[id(trial)] = trial, path
            if len(self._paths) > CACHE_ENTRIES:
                self._paths.popitem(last=False)
        return self._paths[id(trial)][1]


def _means(model: NeedleModel, trials: Sequence[BinnedTrial], solved: Sequence[Sampled]) -> list[Array]:
    """Bin means (C, K) of what the sensors read of each trial's solution."""
    found = []
    observes = bool(model.acting("observe"))
    for binned, sampled in zip(trials, solved, strict=True):
        torque_nm, hall_rad = sampled.torque_nm, sampled.sensor_rad
        if observes:
            seen = model.observed(binned.trial, sampled)
            torque_nm, hall_rad = seen.torque_nm, seen.hall_rad
        found.append(binned.averaged(np.vstack([torque_nm[None, :], hall_rad.T])))
    return found


class _Carry:
    """What is read on a path, carried over to paths that turn back where it does.

    On a way without turning back, what is read is that of the turning point before and a function of the way
    since: y = y_r + g(θ − θ_r). A change of the path moves it by δy_r + g′ (δ − δ_r).
    """

    def __init__(self, path: Path, sampled: Sampled) -> None:
        self._path, self._sampled = path, sampled
        self._step_rad = np.diff(path.base_rad, prepend=0.0)  # a needle begins relaxed at 0
        size = np.abs(self._step_rad)
        turning = np.flatnonzero(size > TURNING * size.max(initial=0.0))
        self._ways: list[tuple[slice, int]] = []
        """Samples of each way, and the last at which the base still turned."""
        if turning.size:
            back = np.flatnonzero(np.diff(np.sign(self._step_rad[turning])))
            edges = [0, *turning[back + 1].tolist(), size.size]
            ends = [*turning[back].tolist(), int(turning[-1])]
            self._ways = [(slice(a, b), end) for a, b, end in zip(edges[:-1], edges[1:], ends, strict=True)]
            # at rest the needle stays where the last turn left it
            places = np.searchsorted(turning, np.arange(size.size), side="right") - 1
            last = turning[np.maximum(places, 0)]
            read = np.column_stack([sampled.torque_nm, sampled.sensor_rad])
            self._slopes = np.diff(read, axis=0, prepend=0.0)[last] / self._step_rad[last, None]

    def to(self, base_rad: Array) -> Sampled | None:
        """What is read on the path `base_rad` (samples,); None where it turns otherwise: where a step differs
        by more than itself."""
        moved_rad = base_rad - self._path.base_rad
        if not moved_rad.any():
            return self._sampled
        differs = np.abs(np.diff(moved_rad, prepend=0.0)) > np.abs(self._step_rad)
        if not self._ways or differs.any():
            return None
        changed, moved_there_rad, change_there = np.empty_like(self._slopes), 0.0, np.zeros(1)
        for way, end in self._ways:
            changed[way] = change_there + self._slopes[way] * (moved_rad[way, None] - moved_there_rad)
            moved_there_rad, change_there = float(moved_rad[end]), changed[end]
        return Sampled(
            self._sampled.torque_nm + changed[:, 0],
            self._sampled.sensor_rad + changed[:, 1:],
            self._sampled.solves,
        )


def _one_rod(model: NeedleModel, trials: Sequence[Trial]) -> tuple[Rod, bool]:
    """The rod of the first trial, and whether it serves all."""
    rods = model.rods(trials)
    return rods[0], all(rod is rods[0] for rod in rods)


def _moving(model: NeedleModel) -> tuple[tuple[Effect, ...], float, float, float]:
    """What moves the needle of a model, but for the path of its held end."""
    moving = tuple(e for e in model.effects if _moves(e) and not e.is_off())
    return moving, model.torsional_rigidity_nm2, model.friction_n, model.element_length_m


def _moves(effect: Effect) -> bool:
    return any(effect.has(hook) for hook in ("shape", "torque"))
