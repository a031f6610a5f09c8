"""The datasets of `scripts/diagnosis_table`: the plan, how one is made, and the answer to it."""

from __future__ import annotations

import dataclasses
import enum
import json
import random
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NotRequired, TypedDict

import numpy as np
from detection import detection_limit, smallest_strength
from scipy.stats import f as f_distribution

from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import Protocol, compensation, load_protocol, staircase
from needle_rig.model import load_parameters
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.physics.rod import Layout
from needle_rig.workbench.estimation.baseline import Baseline, fit_baseline
from needle_rig.workbench.estimation.map_fit import Fit
from needle_rig.workbench.estimation.parameters import (
    FreeParameter,
    against_mean,
    at_strength,
    free_parameters,
    make_effects,
)
from needle_rig.workbench.selection.diagnose import Diagnosis, diagnose
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise

STRENGTHS = (0.5, 1.0, 3.0, 5.0, 10.0)
PAIRS = (
    ("tissue_elasticity", "tip_friction"),
    ("tissue_elasticity", "torque_bias"),
    ("layered_friction", "chuck_backlash"),
    ("viscous_slip", "torque_gain"),
    ("tissue_elasticity", "viscous_slip"),
    ("guide_friction", "hall_offset"),
    ("tip_friction", "chuck_backlash"),
    ("bending_torque", "tissue_elasticity"),
    ("direction_asymmetry", "chuck_compliance"),
    ("hall_gain", "tissue_elasticity"),
)
OTHER_LAYOUT = Layout(0.31, ((0.12, 0.16), (0.18, 0.24), (0.255, 0.30)), (0.17, 0.247, 0.309))
STANDARD = load_protocol("standard")
FEWER_TRIALS = Protocol(
    "fewer",
    (
        compensation(45.0),
        compensation(45.0),
        compensation(-60.0, 20.0),
        staircase((30.0, 70.0, 20.0, -20.0, 10.0)),
        compensation(45.0),
        compensation(90.0, 90.0, 8.0),
    ),
)
FEWEST_TRIALS = Protocol(
    "fewest", (compensation(45.0), compensation(-60.0), compensation(45.0), compensation(-60.0))
)


class Impostor(enum.StrEnum):
    """What is wrong with a dataset in which no effect is hidden."""

    CLOCK_SKEW = "clock skew 10 ms"
    OUTLIERS = "2 % outliers"
    DROPPED_SAMPLES = "dropped samples"
    FINER_SOLVER = "half the solver step"


class Task(TypedDict):
    """One dataset of the plan."""

    kind: str
    setup: int
    seed: int
    effects: NotRequired[list[str]]
    strength: NotRequired[float]
    impostor: NotRequired[str]


Limits = dict[str, tuple[float, float, float]]
"""By effect, setup and sign: detection limit, smallest strength that matters, what multiples count from."""


class Answer(TypedDict, total=False):
    """What came of a dataset; which keys there are hangs on the task's kind."""

    wall_s: float
    cpu_s: float
    limits: Limits
    skipped: str
    crash: str
    verdict: str
    named: list[str]
    ties: dict[str, list[str]]
    after: float | None
    decisions: dict[str, str]
    covered: list[bool]
    relatives: list[str]
    left: list[str]
    rules: list[str]
    f_test: str | None
    aic: str | None
    version: str


class Row(Task, Answer):
    """A dataset and its answer: a line of the table's file."""


@dataclass(frozen=True)
class Setup:
    """What a dataset is measured with, and how; without a layout it is the experiment's."""

    noise: Noise
    layout: Layout | None = None
    protocol: Protocol = STANDARD
    rate_hz: float = 50.0


SETUPS: tuple[Setup, ...] = (
    Setup(Noise(friction_scatter=0.02, rigidity_error=0.02)),
    Setup(Noise(hall_deg=0.12, torque_nmm=0.0004, friction_scatter=0.01, rigidity_error=0.02)),
    Setup(Noise(friction_scatter=0.05, rigidity_error=0.02)),
    Setup(Noise(hall_deg=0.5, torque_nmm=0.0016, friction_scatter=0.03, rigidity_error=0.02)),
    Setup(Noise(friction_scatter=0.02, rigidity_error=0.02), OTHER_LAYOUT, FEWER_TRIALS),
)
POOR = len(SETUPS)
SETUPS += (
    Setup(
        Noise(hall_deg=4.0, torque_nmm=0.016, friction_scatter=0.1, rigidity_error=0.02),
        protocol=FEWEST_TRIALS,
        rate_hz=10.0,
    ),
)
"""The last hides much that matters: it asks whether that is admitted, at half the limit."""


def plan(seeds: int, first: int = 0) -> list[Task]:
    """Every dataset, so ordered that any beginning is a fair sample with the main rows a little ahead.

    Seeds count from `first`.
    """
    names = sorted(find_effects())
    every = range(first, first + seeds)
    half = range(first, first + (seeds + 1) // 2)

    def one(strength: float) -> list[Task]:
        return [
            {"kind": "one", "effects": [n], "strength": strength, "setup": (i + s) % POOR, "seed": s}
            for i, n in enumerate(names)
            for s in every
        ]

    parts = [(0.7, one(3.0)), (1.0, one(10.0)), (1.0, one(1.0)), (1.0, one(5.0)), (0.9, one(0.5))]
    admitted: list[Task] = [
        {"kind": "one", "effects": [n], "strength": 0.5, "setup": POOR, "seed": s}
        for n in names
        for s in half
    ]
    parts.append(
        (
            0.7,
            [{"kind": "none", "setup": s % POOR, "seed": s} for s in range(12 * first, 12 * (first + seeds))],
        )
    )
    for strength in (3.0, 10.0):
        pairs: list[Task] = [
            {"kind": "pair", "effects": p, "strength": strength, "setup": (i + s) % POOR, "seed": s}
            for i, p in enumerate(map(list, PAIRS))
            for s in every
        ]
        parts.append((1.0, pairs))
    removed: list[Task] = [
        {"kind": "removed", "effects": [n], "strength": 10.0, "setup": (i + s + 1) % POOR, "seed": s}
        for i, n in enumerate(names)
        for s in half
    ]
    spoilt: list[Task] = [
        {"kind": "impostor", "impostor": i, "setup": s % POOR, "seed": s}
        for i in Impostor
        for s in range(4 * first, 4 * (first + seeds))
    ]
    parts += [(0.8, removed), (0.9, spoilt), (1.0, admitted)]
    placed: list[tuple[float, int, Task]] = []
    for number, (weight, tasks) in enumerate(parts):
        random.Random(number).shuffle(tasks)
        placed += [(weight * (i + 0.5) / len(tasks), number, t) for i, t in enumerate(tasks)]
    return [t for _, _, t in sorted(placed, key=lambda p: p[:2])]


def key(task: Task) -> str:
    """What tells a dataset from the others."""
    fields = ("kind", "effects", "strength", "setup", "seed", "impostor")
    return json.dumps({f: value for f, value in task.items() if f in fields}, sort_keys=True)


def simulated(given: Setup, effects: Sequence[Effect], seed: int, finer: float = 1.0) -> Dataset:
    """A dataset of a setup with these effects hidden."""
    model = load_parameters("rig_rigid").with_effects(*effects)
    if given.layout is not None:
        model = dataclasses.replace(model, layout=given.layout)
    model = dataclasses.replace(
        model,
        element_length_m=model.element_length_m / finer,
        tolerance_rad=model.tolerance_rad / finer,
    )
    return simulate_dataset(model, given.protocol, seed, given.noise, name="x", rate_hz=given.rate_hz)


def silent(given: Setup) -> Setup:
    """The setup without sensor noise, which `noise_kinds.noisy` then adds; friction scatters as before."""
    return dataclasses.replace(given, noise=dataclasses.replace(given.noise, hall_deg=0.0, torque_nmm=0.0))


_BASELINES: dict[int, Baseline] = {}


def limits_of(setup: int, effect: str, turn: float) -> tuple[float, float, float]:
    """(detection limit, smallest strength that matters, where multiples of 1 and more count from)."""
    library = find_effects()
    if setup not in _BASELINES:
        _BASELINES[setup] = fit_baseline(simulated(SETUPS[setup], (), 987), None, library)
    baseline = _BASELINES[setup]
    return limits_in(baseline, effect, turn)


def limits_in(baseline: Baseline, effect: str, turn: float) -> tuple[float, float, float]:
    """The same of the dataset that the baseline was fitted to."""
    limit = detection_limit(baseline, effect, turn)
    smallest = smallest_strength(baseline.problem.parameters([effect]))
    return limit, smallest, max(limit, smallest)


def hidden_at(
    parameters: Sequence[FreeParameter], library: Mapping[str, type[Effect]], strength: float, turn: float
) -> tuple[tuple[Effect, ...], dict[str, float]]:
    """An effect at a strength in typical sizes, and its values by name but for those of form."""
    scaled_values = at_strength(parameters, strength, turn)
    pairs = zip(parameters, against_mean(parameters, scaled_values), strict=True)
    values = {a.name: a.value(float(p)) for a, p in pairs if not a.info.shapes}
    return make_effects(library, parameters, scaled_values), values


def spoiled(dataset: Dataset, impostor: Impostor, seed: int) -> Dataset:
    """A dataset with a fault of measurement in it."""
    generator = np.random.default_rng(seed + 5000)
    trials = []
    for given in dataset.trials:
        time_s = given.trial.time_s
        torque, hall = given.torque_nm.copy(), given.hall_rad.copy()
        if impostor is Impostor.CLOCK_SKEW:
            late = [np.interp(time_s - 0.01, time_s, c) for c in (torque, *hall.T)]
            new = dataclasses.replace(given, torque_nm=late[0], hall_rad=np.column_stack(late[1:]))
        elif impostor is Impostor.OUTLIERS:
            for column in (torque, *hall.T):
                hit = generator.random(column.size) < 0.02
                column[hit] += generator.standard_normal(hit.sum()) * 30 * np.std(np.diff(column[:20]))
            new = dataclasses.replace(given, torque_nm=torque, hall_rad=hall)
        else:
            keep = generator.random(time_s.size) > 0.1
            keep[[0, -1]] = True
            base = given.trial.base_angle_rad[keep]
            new = dataclasses.replace(
                given,
                trial=dataclasses.replace(given.trial, time_s=time_s[keep], base_angle_rad=base),
                base_measured_rad=given.base_measured_rad[keep],
                torque_nm=torque[keep],
                hall_rad=hall[keep],
                phase=given.phase[keep],
            )
        trials.append(new)
    return dataclasses.replace(dataset, trials=tuple(trials))


def judge(task: Task, known: Limits) -> Row:
    """Make one dataset, diagnose it, and note what the answer was."""
    try:
        return {**task, **judged(task, known)}
    except Exception:  # noqa: BLE001 a crash is an answer too: it is counted
        crash: Answer = {"crash": traceback.format_exc(limit=-4)}
        return {**task, **crash}


@dataclass(frozen=True)
class Made:
    """A dataset of the table with what is known of it."""

    dataset: Dataset
    library: dict[str, type[Effect]]
    truth: dict[str, dict[str, float]]
    limits: Limits


def made(task: Task, known: Limits) -> Made | None:
    """The dataset of a task; None when its effect does not show in the setup at any strength."""
    library = dict(find_effects())
    layout = SETUPS[task["setup"]].layout or load_parameters("rig_rigid").layout
    turn = -1.0 if task["seed"] % 2 else 1.0
    hidden: list[Effect] = []
    truth: dict[str, dict[str, float]] = {}
    limits: Limits = {}
    for name in task.get("effects", ()):
        place = f"{name} {task['setup']} {turn:+.0f}"
        limit, smallest, matters = known.get(place) or limits_of(task["setup"], name, turn)
        limits[place] = (limit, smallest, matters)
        if not np.isfinite(limit):
            return None
        parameters = free_parameters(library, [name], layout)
        strength = task["strength"] * (limit if task["strength"] < 1 else matters)
        effects, truth[name] = hidden_at(parameters, library, strength, turn)
        hidden += effects
    impostor = Impostor(task["impostor"]) if "impostor" in task else None
    seed = 10_000 + 7 * task["seed"] + sum(map(ord, key({**task, "seed": 0})))
    finer = 2.0 if impostor is Impostor.FINER_SOLVER else 1.0
    dataset = simulated(SETUPS[task["setup"]], hidden, seed, finer)
    if impostor is not None and impostor is not Impostor.FINER_SOLVER:
        dataset = spoiled(dataset, impostor, seed)
    if task["kind"] == "removed":
        library.pop(task["effects"][0])
    return Made(dataset, library, truth, limits)


def judged(task: Task, known: Limits) -> Answer:
    """The answer to one dataset."""
    given = made(task, known)
    if given is None:
        return {"limits": {}, "skipped": f"{' '.join(task['effects'])} does not show in this setup"}
    answer, found = answer_to(given.dataset, given.library, given.truth)
    answer["limits"] = given.limits
    if task["kind"] in ("one", "none"):
        answer["f_test"], answer["aic"] = naive(found)
    return answer


def answer_to(
    dataset: Dataset, library: Mapping[str, type[Effect]], truth: Mapping[str, Mapping[str, float]]
) -> tuple[Answer, Diagnosis]:
    """The diagnosis of a dataset, and what of it is judged; `truth` holds the hidden effects' values."""
    begun, cpu = time.monotonic(), time.process_time()
    found = diagnose(dataset, library)
    wall_s, cpu_s = round(time.monotonic() - begun, 1), round(time.process_time() - cpu, 1)
    named = found.ranking[: len(found.effects)]
    values = [(v, truth[r.effect].get(v.name)) for r in named if r.effect in truth for v in r.values]
    answer: Answer = {
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "verdict": found.verdict,
        "named": list(found.effects),
        "ties": {r.effect: list(r.indistinguishable_from) for r in named},
        "after": found.held_out_error_after,
        "decisions": {n: found.decisions[n].decision for n in truth if n in found.decisions},
        "covered": [v.low <= value <= v.high for v, value in values if value is not None],
        "relatives": relatives(list(truth)),
        "left": [p.sentence() for p in found.residual_patterns.patterns[:2]],
        "rules": [r.rule for r in found.reasons],
    }
    return answer, found


def relatives(effects: list[str]) -> list[str]:
    """Declared relatives, either way."""
    every = find_effects()
    related = {r for n in effects for r in every[n].relatives}
    related |= {n for n in every for e in effects if e in every[n].relatives}
    return sorted(related - set(effects))


def naive(found: Diagnosis) -> tuple[str | None, str | None]:
    """What the independent-noise F-test and AIC over raw samples say of the same candidates."""
    problem, search = found.search.problem, found.search
    trials = list(range(len(problem.trials)))
    samples = sum(int(b.count.sum()) for b in problem.trials)

    def squares(fit: Fit) -> float:
        vector = dataclasses.replace(fit.vector, trial_friction=np.zeros(len(trials)))
        readings = problem.readings([problem.model(fit.parameters, vector, t) for t in trials], trials)
        white = problem.noise.white[:, None]
        pairs = zip(problem.trials, readings, strict=True)
        return samples + sum(float(np.nansum(((b.mean - r) / white) ** 2 * b.count)) for b, r in pairs)

    base = squares(search.root)
    tests: dict[str, float] = {}
    gains: dict[str, float] = {}
    for candidate in search.children.get(search.start, []):
        if candidate.fit is not None:
            k, now = len(candidate.fit.parameters), squares(candidate.fit)
            ratio = max(base - now, 0.0) / k / (now / (samples - k - 2))
            tests[candidate.effect] = float(f_distribution.sf(ratio, k, samples - k - 2))
            gains[candidate.effect] = base - now - 2 * k
    first, best = (
        min(tests, key=tests.__getitem__, default=None),
        max(gains, key=gains.__getitem__, default=None),
    )
    return (
        first if first and tests[first] < 0.01 else None,
        best if best and gains[best] > 0 else None,
    )
