"""Which reading, not measured yet, would tell models apart that meet the same settled values.

Whoever repeats a sequence records the base angle with it. So every model is driven by one base path: the path
that the first model's loop takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.control.strategy import History, make_strategy
from needle_rig.dataset.settled import Seen
from needle_rig.units import deg, nmm
from needle_rig.workbench.published.fit import SettledFit, SettledProblem
from needle_rig.workbench.selection.documents import NextSettled, Watched, WatchedPair
from needle_rig.workbench.selection.values import spelt_sigmas
from needle_rig.workbench.virtual.noise import NO_NOISE
from needle_rig.workbench.virtual.settled_run import run_settled


@dataclass(frozen=True)
class Watch:
    """One reading after one motion (counted from 1), and what each of the models gives for it."""

    of: Seen
    number: int
    given: tuple[float, ...]
    turned: tuple[float, ...]
    """Change of that reading in the motion, by each of the models."""
    sigmas: float
    """The first model's smallest distance to another, over the standard error."""


def drive(problem: SettledProblem, found: SettledFit, paths: Sequence[History]) -> tuple[History, ...]:
    """Every sequence on a fitted model, with the base angles of `paths`. Raises SolverError."""
    model = problem.model(found.parameters, found.x)
    random = np.random.default_rng(0)
    runs = []
    for path, (_, task) in zip(paths, problem.loops, strict=True):
        steps = make_strategy("protocol", {"steps_deg": tuple(deg(m.waypoint_rad) for m in path[1:])})
        runs.append(
            run_settled(model, steps, task, random, NO_NOISE, zeroed=problem.data.zeroed_at_rest).history
        )
    return tuple(runs)


def watches(problem: SettledProblem, fits: Sequence[SettledFit]) -> list[Watch]:
    """Readings of sensors with a stated standard error that are not among the data, most telling first."""
    paths = problem.run(problem.model(fits[0].parameters, fits[0].x))
    runs = [drive(problem, f, paths) for f in fits]
    known = {v.of for v in problem.data.values}
    found = []
    for s, (sequence, path) in enumerate(zip(problem.data.sequences, paths, strict=True)):
        channels: list[tuple[str, int | None]] = [("torque_nmm", None)]
        channels += [("hall_deg", k) for k in range(len(problem.data.sensor_names))]
        for number, motion in enumerate(path[1:], start=1):
            for quantity, sensor in channels:
                error = sequence.standard_errors.get(quantity)
                of = Seen(s, motion.name, quantity, sensor)
                if error is None or of in known:
                    continue
                given = [_reading(run[s], number, sensor) for run in runs]
                before = [_reading(run[s], number - 1, sensor) for run in runs]
                apart = min(abs(given[0] - other) for other in given[1:])
                turned = tuple(g - b for g, b in zip(given, before, strict=True))
                found.append(Watch(of, number, tuple(given), turned, apart / error))
    return sorted(found, key=lambda w: -w.sigmas)


def next_experiment(
    problem: SettledProblem, names: Sequence[str], fits: Sequence[SettledFit]
) -> NextSettled | None:
    """What to watch to tell the first of the tied effects from all others, and each pair from another.

    None when no sensor has a stated standard error.
    """
    ranked = watches(problem, fits)
    if not ranked:
        return None
    best = ranked[0]
    sequence = problem.data.sequences[best.of.sequence]
    pairs: list[WatchedPair] = []
    for i, first in enumerate(names):
        for j in range(i + 1, len(names)):
            top = watches(problem, (fits[i], fits[j]))[0]
            pairs.append({"between": [first, names[j]], **_told(problem, top)})
    return {
        "between": list(names),
        "kind": "compensate",
        "strategy": sequence.strategy,
        "options": dict(sequence.options),
        "target_deg": sequence.target_deg,
        "speed_deg_s": sequence.speed_deg_s,
        "settle_s": sequence.settle_s,
        **_told(problem, best),
        "sentence": _sentence(problem, names, best),
        "pairs": pairs,
    }


def _reading(history: History, number: int, sensor: int | None) -> float:
    motion = history[number]
    return nmm(motion.torque_nm) if sensor is None else deg(motion.hall_rad[sensor])


def _told(problem: SettledProblem, watch: Watch) -> Watched:
    return {
        "separation_sigma": round(watch.sigmas, 2),
        "watch": f"{problem.data.words(watch.of)} (motion {watch.number})",
        "sensor": "torque" if watch.of.sensor is None else problem.data.sensor_names[watch.of.sensor],
        "motion": watch.number,
        "unit": watch.of.unit,
        "expected": [round(v, 4) for v in watch.given],
        "turned": [round(v, 4) + 0.0 for v in watch.turned],
    }


def _sentence(problem: SettledProblem, names: Sequence[str], watch: Watch) -> str:
    sequence = problem.data.sequences[watch.of.sequence]
    sensor = "the torque" if watch.of.sensor is None else problem.data.sensor_names[watch.of.sensor]
    digits = 3 if watch.of.unit == "N·mm" else 1

    def change(k: int) -> str:
        return f"{round(watch.turned[k], digits) + 0.0:+.{digits}f} {watch.of.unit} with {names[k]}"

    others = ", ".join(change(k) for k in range(1, len(names)))
    return (
        f"{sequence.title} to {sequence.target_deg:g}° again, with the base angle and every sensor recorded:"
        f" watch {sensor} in motion {watch.number} ({watch.of.motion}). At the same base angles it changes by"
        f" {change(0)}, {others}; settled after it they are {spelt_sigmas(watch.sigmas)} apart."
    )
