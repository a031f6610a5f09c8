"""Every strategy on one needle: what it leaves, what it costs, with medians and 95 % quantiles."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

import numpy as np

from needle_rig.control.strategy import Reason, Strategy, Task, Trust, find_strategies, make_strategy
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel
from needle_rig.numerics import Array
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.units import deg, nmm, rad
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.virtual.noise import Noise
from needle_rig.workbench.virtual.settled_run import SettledRun, run_settled

WOUND_DEG = 60.0
SPEED_DEG_S = 45.0
SETTLE_S = 3.0
ANGLE_LIMIT_DEG = 720.0
STARTS = ("relaxed", "wound")
NEEDS_OTHERS = ("protocol",)
"""Strategies that only carry out a given sequence."""
MUCH_BETTER = 3.0
"""Ratio of worst errors below which the reason is given why planning gains no more."""
FARTHEST_TARGET_DEG = 360.0
STRAIGHT_DEG = 3.0
"""Worst error of reed2008 below which there is little to gain: two or three times the Hall sensors' noise."""
PREDICTION_RUNS = 8


@dataclass(frozen=True)
class Bout:
    """What every sequence is run with. `torsional_rigidity_nm2` is the stated constant of the rig."""

    plant: NeedleModel
    torsional_rigidity_nm2: float
    noise: Noise = field(default_factory=lambda: Noise(friction_scatter=0.05))
    saved: SavedModel | None = None
    speed_deg_s: float = SPEED_DEG_S
    settle_s: float = SETTLE_S

    def task(self, target_deg: float, lag_left_rad: float | None = None) -> Task:
        """What a strategy knows."""
        saved = self.saved
        return Task(
            target_rad=rad(target_deg),
            layout=self.plant.layout,
            torsional_rigidity_nm2=self.torsional_rigidity_nm2,
            speed_rad_s=rad(self.speed_deg_s),
            settle_s=self.settle_s,
            angle_limit_rad=rad(ANGLE_LIMIT_DEG),
            velocity_limit_rad_s=rad(60.0),
            acceleration_limit_rad_s2=rad(360.0),
            model=saved.model if saved else None,
            trust=Trust(saved.uncertainties, saved.error_over_floor) if saved else Trust(),
            lag_left_rad=lag_left_rad,
        )

    def run(self, strategy: Strategy, target_deg: float, start: str, seed: int) -> SettledRun:
        """One sequence; seeds are common to all strategies, so that they meet the same needles."""
        random = np.random.default_rng([seed, int(1000 * abs(target_deg)), STARTS.index(start), 7])
        scatter = max(0.05, 1.0 + self.noise.friction_scatter * float(random.standard_normal()))
        needle = self.plant.with_effects(FrictionOfTrial(scatter))
        wound = rad(WOUND_DEG) * float(np.sign(target_deg)) if start == "wound" else 0.0
        lag = None
        if strategy.name == "reed2008_elastic":
            before = self.run(make_strategy("reed2008", {}), target_deg, start, seed + 1_000_003)
            lag = before.history[-1].tip_lag_rad * float(np.sign(target_deg))
        return run_settled(needle, strategy, self.task(target_deg, lag), random, self.noise, wound_rad=wound)


@dataclass(frozen=True)
class Result:
    """One sequence that ended, in the units of the table; `refused` is a sentence when it did not start."""

    strategy: str
    target_deg: float
    start: str
    values: Mapping[str, float]
    refused: str = ""
    gave_way: bool = False
    """The planner found its model wrong and went on as reed2008."""


def one_result(bout: Bout, kind: type[Strategy], target_deg: float, start: str, seed: int) -> Result:
    """Run a strategy once."""
    find_strategies()  # names them, also in a process that begins with this
    try:
        run = bout.run(kind(), target_deg, start, seed)
    except BadInput as refusal:
        return Result(kind.name, target_deg, start, {}, refused=str(refusal))
    target = rad(target_deg)
    values = {
        "tip_lag_deg": deg(abs(run.history[-1].base_angle_rad - run.tip_rad)),
        "worst_deg": deg(run.worst_rad(target)),
        "mean_deg": deg(run.mean_rad(target)),
        "torque_nmm": nmm(abs(run.torque_nm)),
        "rotations": float(run.rotations),
        "total_rotation_deg": deg(run.total_rotation_rad),
        "time_s": run.time_s,
    }
    gave_way = any(motion.reason is not Reason.STRATEGY for motion in run.history)
    return Result(kind.name, target_deg, start, values, gave_way=gave_way)


class Spread(TypedDict):
    """Of several runs."""

    median: float
    q95: float


class Summary(TypedDict, total=False):
    """Several runs of one strategy; without those of a strategy that refused to start."""

    tip_lag_deg: Spread
    worst_deg: Spread
    mean_deg: Spread
    torque_nmm: Spread
    rotations: float
    total_rotation_deg: float
    time_s: float
    runs: int
    gave_way_to_reed2008: int
    refused: str


class StrategyOverall(Summary):
    """All runs of one strategy."""

    strategy: str


class StrategyRow(StrategyOverall):
    """The runs of one strategy to one target."""

    target_deg: float
    starts: dict[str, Summary]


@dataclass(frozen=True)
class Table:
    """All results, by strategy in the order in which they were asked for."""

    results: tuple[Result, ...]
    strategies: tuple[str, ...]
    targets_deg: tuple[float, ...]

    def chosen(
        self, strategy: str, target_deg: float | None = None, start: str | None = None
    ) -> list[Result]:
        """Results of one strategy, of all targets or starts where none is given."""
        return [
            r
            for r in self.results
            if r.strategy == strategy
            and target_deg in (None, r.target_deg)
            and start in (None, r.start)
            and r.values
        ]

    def rows(self) -> list[StrategyRow]:
        """One row a strategy and target, both starts together, and each start by itself under `starts`."""
        return [
            {
                "strategy": strategy,
                "target_deg": target,
                **summary(self.chosen(strategy, target)),
                "starts": {
                    start: summary(self.chosen(strategy, target, start))
                    for start in dict.fromkeys(r.start for r in self.results)
                },
                **self._remarks(strategy),
            }
            for strategy in self.strategies
            for target in self.targets_deg
        ]

    def overall(self) -> list[StrategyOverall]:
        """One row a strategy over all targets and starts."""
        return [{"strategy": s, **summary(self.chosen(s)), **self._remarks(s)} for s in self.strategies]

    def _remarks(self, strategy: str) -> Summary:
        refused = {r.refused for r in self.results if r.strategy == strategy and r.refused}
        return {"refused": sorted(refused)[0]} if refused else {}


def summary(results: Sequence[Result]) -> Summary:
    """Median and 95 % quantile of errors; medians of rotations, total rotation and time."""
    if not results:
        return {}

    def column(key: str) -> Array:
        return np.array([r.values[key] for r in results])

    def spread(key: str) -> Spread:
        return {"median": _round(np.median(column(key))), "q95": _round(np.quantile(column(key), 0.95))}

    told: Summary = {
        "tip_lag_deg": spread("tip_lag_deg"),
        "worst_deg": spread("worst_deg"),
        "mean_deg": spread("mean_deg"),
        "torque_nmm": spread("torque_nmm"),
        "rotations": _round(np.median(column("rotations"))),
        "total_rotation_deg": _round(np.median(column("total_rotation_deg"))),
        "time_s": _round(np.median(column("time_s"))),
        "runs": len(results),
    }
    if any(r.gave_way for r in results):
        told["gave_way_to_reed2008"] = sum(r.gave_way for r in results)
    return told


def all_strategies() -> tuple[str, ...]:
    """Every strategy that finds its own way, by name."""
    return tuple(name for name in find_strategies() if name not in NEEDS_OTHERS)


def check_asked(strategies: Sequence[str], targets_deg: Sequence[float]) -> None:
    """Raises BadInput for a strategy that there is not, and for a target too far to turn to."""
    known = all_strategies()
    for name in strategies:
        if name not in known:
            raise BadInput(f"strategy {name!r} is unknown; there are {', '.join(known)}")
    if not targets_deg:
        raise BadInput("no target was named; give one angle at least")
    for target in targets_deg:
        if not 0.0 < abs(target) <= FARTHEST_TARGET_DEG:
            raise BadInput(f"target {target:g}°: give angles of up to ±{FARTHEST_TARGET_DEG:g}°, and not 0")


def compare_strategies(
    bout: Bout,
    strategies: Sequence[str],
    targets_deg: Sequence[float],
    seeds: int,
    *,
    starts: Sequence[str] = STARTS,
    first_seed: int = 0,
    work: Work | None = None,
) -> Table:
    """Run every strategy from every start to every target, `seeds` times. Raises BadInput, SolverError."""
    check_asked(strategies, targets_deg)
    found = find_strategies()
    tasks = [
        (found[name], float(target), start, first_seed + seed)
        for name in strategies
        for target in targets_deg
        for start in starts
        for seed in range(seeds)
    ]
    with work or Work() as at:
        at.share(bout)
        results = at.run(one_result, tasks)
    return Table(tuple(results), tuple(strategies), tuple(float(t) for t in targets_deg))


PREDICTION_SEED = 70_000
"""Needles of the model, that no run on the plant will meet."""


@dataclass(frozen=True)
class Predicted:
    """What planned and reed2008 should leave at the worst place of the shaft, and a sentence; NaN if refused.

    `q95_deg` is planned's 95 % quantile.
    """

    planned_deg: float
    q95_deg: float
    reed2008_deg: float
    sentence: str

    @property
    def little_gained(self) -> bool:
        """Whether planning will not be `MUCH_BETTER` times as good."""
        return self.reed2008_deg < MUCH_BETTER * self.planned_deg


def predicted(
    bout: Bout, targets_deg: Sequence[float], starts: Sequence[str] = STARTS, work: Work | None = None
) -> Predicted:
    """What the two will leave on needles of the model, for the same targets and starts, medians in degrees.

    Said before the plant is touched: whether planning will be `MUCH_BETTER` times as good, or why not.
    """
    assert bout.saved is not None
    error = bout.saved.error_over_floor
    try:
        make_strategy("planned", {}).check(bout.task(targets_deg[0]))
    except BadInput as refusal:
        return Predicted(math.nan, math.nan, math.nan, str(refusal))
    twin = dataclasses.replace(bout, plant=bout.saved.model)
    seeds = max(1, round(PREDICTION_RUNS / (len(targets_deg) * len(starts))))
    names = ("planned", "reed2008")
    table = compare_strategies(
        twin, names, targets_deg, seeds, starts=starts, first_seed=PREDICTION_SEED, work=work
    ).overall()
    ours, q95 = table[0]["worst_deg"]["median"], table[0]["worst_deg"]["q95"]
    plain = table[1]["worst_deg"]["median"]
    told = (
        f"planned should leave {ours:.1f}° (95 %: {q95:.1f}°) at the worst place of the shaft,"
        f" reed2008 {plain:.1f}°"
    )
    if error is not None:
        told += f" (model error on held-out runs: {error:.1f} × the floor)"
    if plain < MUCH_BETTER * ours:
        why = (
            "reed2008 leaves little to gain here, and planned turns on only while a rotation brings enough"
            if plain < STRAIGHT_DEG
            else "no sequence within the bound on the overshoot leaves this needle straighter"
        )
        told += f": less than {MUCH_BETTER:g} times better, because {why}"
    return Predicted(ours, q95, plain, told)


def _round(value: Any) -> float:
    return float(f"{float(value):.4g}")
