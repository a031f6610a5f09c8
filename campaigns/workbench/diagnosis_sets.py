"""The datasets of `diagnosis_table`: the plan, how one is made, and the answer to it."""

from __future__ import annotations

import dataclasses
import enum
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.stats import f as f_distribution

from campaigns.run import Row, key
from campaigns.workbench.detection import detection_limit, smallest_strength
from campaigns.workbench.textbook_sets import dataset, rig
from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import Protocol, compensation, load_protocol, staircase
from needle_rig.model import load_parameters
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.physics.machine import NEEDLE, fitting
from needle_rig.physics.rod import Layout
from needle_rig.workbench.estimation.baseline import Baseline, fit_baseline
from needle_rig.workbench.estimation.parameters import (
    FreeParameter,
    against_mean,
    at_strength,
    free_parameters,
    make_effects,
)
from needle_rig.workbench.estimation.problem import Fit
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
SNAPPING_RATIOS, SNAPPING_DAMPING = (0.5, 0.8), 0.01
"""Kinetic over static friction of the needle of another code, and its damping, N·mm·s per 100 mm."""
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


Task = Row
"""`kind`, `setup`, `seed`; by kind also `effects`, `strength`, `impostor` or `ratio`."""
Limits = tuple[float, float, float]
"""Detection limit, smallest strength that matters, where multiples of 1 and more count from."""


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
    names = sorted(fitting(find_effects(), NEEDLE))
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
    snapping: list[Task] = [
        {"kind": "snapping", "ratio": ratio, "setup": 0, "seed": s}
        for ratio in SNAPPING_RATIOS
        for s in every
    ]
    parts += [(0.8, removed), (0.9, spoilt), (1.0, admitted), (1.0, snapping)]
    placed: list[tuple[float, int, Task]] = []
    for number, (weight, tasks) in enumerate(parts):
        random.Random(number).shuffle(tasks)
        placed += [(weight * (i + 0.5) / len(tasks), number, t) for i, t in enumerate(tasks)]
    return [t for _, _, t in sorted(placed, key=lambda p: p[:2])]


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


@cache
def _baseline(setup: int) -> Baseline:
    return fit_baseline(simulated(SETUPS[setup], (), 987), None, find_effects())


@cache
def limits_of(setup: int, effect: str, turn: float) -> Limits:
    """What an effect counts from in a setup, in typical sizes."""
    return limits_in(_baseline(setup), effect, turn)


def limits_in(baseline: Baseline, effect: str, turn: float) -> Limits:
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


def spoiled(data: Dataset, impostor: Impostor, seed: int) -> Dataset:
    """A dataset with a fault of measurement in it."""
    generator = np.random.default_rng(seed + 5000)
    trials = []
    for given in data.trials:
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
    return dataclasses.replace(data, trials=tuple(trials))


@dataclass(frozen=True)
class Made:
    """A dataset with what is known of it: values of hidden effects, and limits, by effect."""

    dataset: Dataset
    library: dict[str, type[Effect]]
    truth: dict[str, dict[str, float]] = field(default_factory=dict)
    limits: dict[str, Limits] = field(default_factory=dict)


def made(task: Task) -> Made | str:
    """The dataset of a task, or why it cannot be asked."""
    library = dict(find_effects())
    if task["kind"] == "snapping":
        plain = rig(task["ratio"], SNAPPING_DAMPING, 1.0)
        return Made(dataset(plain, STANDARD, 10_000 + task["seed"], Noise(), "x"), library)
    layout = SETUPS[task["setup"]].layout or load_parameters("rig_rigid").layout
    turn = -1.0 if task["seed"] % 2 else 1.0
    hidden: list[Effect] = []
    truth: dict[str, dict[str, float]] = {}
    limits: dict[str, Limits] = {}
    for name in task.get("effects", ()):
        limit, _, matters = limits[name] = limits_of(task["setup"], name, turn)
        if not np.isfinite(limit):
            return "does not show"
        parameters = free_parameters(library, [name], layout)
        strength = task["strength"] * (limit if task["strength"] < 1 else matters)
        effects, truth[name] = hidden_at(parameters, library, strength, turn)
        hidden += effects
    impostor = Impostor(task["impostor"]) if "impostor" in task else None
    fields = ("kind", "effects", "strength", "setup", "seed", "impostor")
    text = key({name: value for name, value in {**task, "seed": 0}.items() if name in fields})
    seed = 10_000 + 7 * task["seed"] + sum(map(ord, text))
    finer = 2.0 if impostor is Impostor.FINER_SOLVER else 1.0
    data = simulated(SETUPS[task["setup"]], hidden, seed, finer)
    if impostor is not None and impostor is not Impostor.FINER_SOLVER:
        data = spoiled(data, impostor, seed)
    if task["kind"] == "removed":
        library.pop(task["effects"][0])
    return Made(data, library, truth, limits)


def answer_to(given: Made) -> tuple[Row, Diagnosis]:
    """The diagnosis of a dataset, and what of it is judged."""
    found, truth = diagnose(given.dataset, given.library), given.truth
    named = found.ranking[: len(found.effects)]
    values = [(v, truth[r.effect].get(v.name)) for r in named if r.effect in truth for v in r.values]
    answer: Row = {
        "verdict": found.verdict,
        "named": list(found.effects),
        "ties": {r.effect: list(r.indistinguishable_from) for r in named},
        "after": found.held_out_error_after,
        "decisions": {n: found.decisions[n].decision for n in truth if n in found.decisions},
        "covered": [v.low <= value <= v.high for v, value in values if value is not None],
        "relatives": relatives(list(truth)),
        "left": [p.sentence() for p in found.residual_patterns.patterns[:2]],
        "rules": [r.rule for r in found.reasons],
        "limits": given.limits,
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
