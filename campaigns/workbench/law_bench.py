"""How often a law that no library holds is found: hidden laws, fresh seeds.

The laws are those of `hidden_laws.py` at three sizes, two of them at once, one beside an effect of the
library, and some in a needle that shares no code with the solver (tests/physics/textbook_needle.py); besides,
datasets with nothing hidden, with each effect of the library at its typical size, and with faults of
measurement, in which no law is to be said.
"""

from __future__ import annotations

import dataclasses
import random
import time
from argparse import Namespace
from collections.abc import Iterable

import numpy as np

from campaigns.run import Campaign, Row, answered, key
from campaigns.workbench.hidden_laws import BY_NAME, LAWS, HiddenLaw
from campaigns.workbench.noise_kinds import KINDS, noisy
from campaigns.workbench.rates import HEAD, line
from campaigns.workbench.textbook_sets import dataset as dataset_of
from campaigns.workbench.textbook_sets import rig
from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import Protocol, load_protocol
from needle_rig.model import load_parameters
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.physics.machine import NEEDLE, fitting
from needle_rig.workbench.estimation.parameters import (
    at_strength,
    constrained_means,
    free_parameters,
    make_effects,
)
from needle_rig.workbench.laws.draft import Origin
from needle_rig.workbench.laws.learn_laws import learn_laws
from needle_rig.workbench.laws.learnt import LearntLaw
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise
from tests.physics.textbook_needle import Push

SIZES = {"weak": 0.3, "medium": 1.0, "strong": 2.0}
NOISE = Noise(friction_scatter=0.02, rigidity_error=0.02)
PAIRS = (
    ("slit", "cross_talk"),
    ("hall_2_third", "chuck_creeps"),
    ("detent", "magnet_turns"),
    ("stop", "index_runs"),
)
"""Two laws that act apart,"""
BESIDE = (
    ("tissue_elasticity", "slit"),
    ("chuck_backlash", "hall_2_third"),
    ("tip_friction", "dead_cell"),
    ("torque_gain", "chuck_creeps"),
)
"""and an effect of the library with a law."""
FAULT_SEEDS = 20
"""Datasets of each fault of measurement."""
FAULTS = ("outliers", "wanders over 2 s", "drop-outs", "late clock")
DAMPING, CELL_M = 0.01, 5e-3
"""Of the needle that is not ours: N·mm·s per 100 mm, which its explicit steps need, and its cells."""
LATE_S = 0.03
"""By which the Hall readings come late where their clock is."""
FOREIGN = ("hall_2_third", "dead_cell", "magnet_turns", "lag", "chuck_creeps", "slit", "notch")
"""Laws in the needle that is not ours."""


def plan(given: Namespace) -> list[Row]:
    """Every dataset, so ordered that any beginning is a fair sample."""
    tasks: list[Row] = []
    first = given.first_seed
    faulty = range(first, first + FAULT_SEEDS)
    for seed in range(first, first + given.size):
        tasks += [{"law": law.name, "size": size, "seed": seed} for law in LAWS for size in SIZES.values()]
        tasks += [{"effect": name, "seed": seed} for name in sorted(fitting(find_effects(), NEEDLE))]
        tasks += [{"nothing": k, "seed": seed} for k in range(20)]
        tasks += [{"laws_hidden": list(pair), "seed": seed} for pair in PAIRS]
        tasks += [{"beside": effect, "laws_hidden": [law], "seed": seed} for effect, law in BESIDE]
        tasks += [{"foreign": law, "seed": seed} for law in FOREIGN]
    tasks += [{"fault": fault, "seed": seed} for fault in FAULTS for seed in faulty]
    random.Random(0).shuffle(tasks)
    return tasks


def made(task: Row) -> Dataset:
    """The dataset of a task."""
    number = sum(map(ord, key({k: v for k, v in task.items() if k != "seed"})))
    seed = 1000 * number + task["seed"]
    protocol = load_protocol("standard")
    if "foreign" in task:
        return foreign(BY_NAME[task["foreign"]], protocol, seed)
    library, effects = find_effects(), list[Effect]()
    if "law" in task:
        effects = [BY_NAME[task["law"]].at(task["size"])]
    elif "effect" in task:
        effects = [library[task["effect"]].at_strength(1.0)]
        parameters = free_parameters(library, (task["effect"],), load_parameters("rig_rigid").layout)
        if constrained_means(parameters):  # what all items share is friction
            effects = list(make_effects(library, parameters, at_strength(parameters, 1.0)))
    elif "laws_hidden" in task:
        effects = [BY_NAME[name].at(1.0) for name in task["laws_hidden"]]
        effects += [library[task["beside"]].at_strength(1.0)] if "beside" in task else []
    model = load_parameters("rig_rigid").with_effects(*effects)
    fault: str = task.get("fault", "")
    if fault in KINDS:
        still = dataclasses.replace(NOISE, hall_deg=0.0, torque_nmm=0.0)
        return noisy(simulate_dataset(model, protocol, seed, still, name="x"), fault, NOISE, seed)
    dataset = simulate_dataset(model, protocol, seed, NOISE, name="x")
    return late(dataset) if fault else dataset


def late(dataset: Dataset) -> Dataset:
    """The same with Hall readings that come late."""
    trials = []
    for each in dataset.trials:
        time_s = each.trial.time_s
        halls = [np.interp(time_s - LATE_S, time_s, hall) for hall in each.hall_rad.T]
        trials.append(dataclasses.replace(each, hall_rad=np.column_stack(halls)))
    return dataclasses.replace(dataset, trials=tuple(trials))


def foreign(law: HiddenLaw, protocol: Protocol, seed: int) -> Dataset:
    """A series of the needle that is not ours, with a law at size 1. Its curve gives its torque."""
    plain = dataclasses.replace(rig(1.0, DAMPING, 1.0), cell_m=CELL_M)
    if law.hook == "torque":
        section = plain.layout.tissue_sections_m[int(law.place.removeprefix("section_")) - 1]
        angles = np.linspace(-np.pi, np.pi, 721)
        # N·mm per 100 mm in N
        push = Push(*section, -np.pi, np.pi, 1e-2 * law.curve(1.0, np.degrees(angles)))
        return dataset_of(dataclasses.replace(plain, push=push), protocol, seed, NOISE, "x")
    return dataset_of(plain, protocol, seed, NOISE, "x", law.at(1.0))


def ask(task: Row, _: Namespace) -> Row:
    """The answer to one dataset."""
    begun = time.monotonic()
    found = learn_laws(made(task), find_effects(), origin=Origin("x", "0" * 64, "-"))
    answer = found.as_json(time.monotonic() - begun)
    if "law" in task and len(found.laws) == 1 and placed({**task, **answer}):
        answer["inside"] = inside(BY_NAME[task["law"]], task["size"], found.laws[0])
    return {
        **answer,
        "library": list(found.library),
        "before": round(found.held_out_before, 3),
        "after": round(found.held_out_after, 3),
    }


def placed(row: Row) -> bool:
    """Whether hook, place and variable of each law are right, or in a tie of two, and none is too many."""
    hidden = row.get("laws_hidden") or [row.get("law") or row["foreign"]]
    if row["verdict"] != "law" or len(row["laws"]) != len(hidden):
        return False
    return all(any(_is(said, BY_NAME[name]) for said in row["laws"]) for name in hidden)


def held(row: Row) -> bool:
    """Whether an effect of the library that can be the law is named for it."""
    return row["verdict"] == "library" and BY_NAME[row["law"]].held_by in row["library"]


def _is(said: Row, law: HiddenLaw) -> bool:
    wanted = [{"hook": law.hook, "place": law.place, "variable": v} for v in law.variables]
    told = [{k: said[k] for k in ("hook", "place", "variable")}, *said["tied_with"]]
    return len(told) <= 2 and any(each in told for each in wanted)


def inside(law: HiddenLaw, size: float, found: LearntLaw) -> float | None:
    """Share of the places with data at which the true curve lies in the 95 % band; None for a law that ties.

    A drive counts from 0, and a factor on slip limits can go over to the friction.
    """
    if (found.law.hook, found.law.place) != (law.hook, law.place) or found.law.variable not in law.variables:
        return None
    curve = found.curve
    # a direction is 1 at most, and the last place of the curve is a little further on
    at = np.clip(curve.at, -1.0, 1.0) if found.law.variable == "direction" else curve.at
    truth, covered = law.curve(size, at), curve.data > 0
    shift = 0.0
    if law.hook == "drive":
        shift = float(np.interp(0.0, curve.at, curve.value - truth))
    if law.place == "slip_limit":
        ratio = np.log((1.0 + curve.value[covered]) / (1.0 + truth[covered]))
        truth = (1.0 + truth) * np.exp(np.average(ratio, weights=curve.data[covered])) - 1.0
    within = (curve.low <= truth + shift) & (truth + shift <= curve.high)
    return round(float(within[covered].mean()), 3)


def formula_right(row: Row) -> bool:
    """Whether the formula is of the right form, a constant beside it not counted."""
    said = (row["laws"][0]["formula"] or "").partition(":")[0].removeprefix("constant and ")
    return said in BY_NAME[row["law"]].forms


def table(rows: list[Row], _: Namespace) -> str:
    """The figures, in markdown."""
    lines = list(HEAD)

    def say(question: str, asked: str, answers: Iterable[bool]) -> None:
        lines.extend(line(question, asked, answers))

    said = answered(rows)
    every = [r for r in said if "law" in r]
    laws = [r for r in every if not BY_NAME[r["law"]].held_by]
    in_library = [r for r in every if BY_NAME[r["law"]].held_by]
    at_once = [r for r in said if "laws_hidden" in r]
    strange = [r for r in said if "foreign" in r]
    say("a law: hook, place and variable right, or in a tie of two", "≥ 90 %", (placed(r) for r in laws))
    for name, size in SIZES.items():
        say(f"… {name} (size {size:g})", "—", (placed(r) for r in laws if r["size"] == size))
    say("… a wrong law is said", "≤ 3 %", (r["verdict"] == "law" and not placed(r) for r in laws))
    say("… an effect of the library is named for it", "—", (r["verdict"] == "library" for r in laws))
    say("… cannot be told", "—", (r["verdict"] == "cannot_tell" for r in laws))
    say("… nothing is said to be missing", "—", (r["verdict"] == "none" for r in laws))
    say(
        "a law that an effect of the library can be, too: that effect, or the law as above",
        "—",
        (held(r) or placed(r) for r in in_library),
    )
    seen = [r for r in every if r["size"] >= SIZES["medium"]]
    say("strong and medium: error left out ≤ 1.1 × the noise", "≥ 85 %", (r["after"] <= 1.1 for r in seen))
    say(
        "law rightly placed: the right form of formula",
        "≥ 75 %",
        (formula_right(r) for r in every if placed(r)),
    )
    say("nothing hidden: none", "all", (r["verdict"] == "none" for r in said if "nothing" in r))
    effects = [r for r in said if "effect" in r]
    say("an effect of the library: no law", "all", (r["verdict"] != "law" for r in effects))
    say("… named", "—", (r["effect"] in r["library"] for r in effects))
    inside_of = [r["inside"] for r in every if r.get("inside") is not None]
    say(
        "law rightly placed: its curve in the band at 90 % of the data or more",
        "—",
        (i >= 0.9 for i in inside_of),
    )
    if inside_of:
        mean = 100.0 * float(np.mean(inside_of))
        lines.append(
            f"| … places with data at which the true curve lies in the band, mean of the curves | ≥ 90 % |"
            f" {len(inside_of)} | {mean:.0f} % |"
        )
    beside = [r for r in at_once if "beside" in r]
    say("two laws at once: both right, no other", "—", (placed(r) for r in at_once if "beside" not in r))
    say("a law beside an effect of the library: the law right, no other", "—", (placed(r) for r in beside))
    say("… and the effect named", "—", (placed(r) and r["beside"] in r["library"] for r in beside))
    say("a law in a needle that is not ours: right, or in a tie of two", "—", (placed(r) for r in strange))
    faults = [r for r in said if "fault" in r]
    say("a fault of measurement: no law", "≥ 95 %", (r["verdict"] != "law" for r in faults))
    lines += ["", "| hidden | size | said | before → after | formula |", "|---|---|---|---|---|"]
    for row in sorted([*every, *at_once, *strange], key=_hidden):
        places = "; ".join(f"{each['hook']} · {each['place']} · {each['variable']}" for each in row["laws"])
        forms = "; ".join((each["formula"] or "—").partition(":")[0] for each in row["laws"])
        told = f"{row['verdict']}{': ' if places else ''}{places}{beside_it(row)}"
        mark = "" if placed(row) or ("law" in row and held(row)) else " ✗"
        change = f"{row['before']:.2f} → {row['after']:.2f}"
        lines.append(f"| {_hidden(row)[0]} | {row.get('size', 1.0):g} | {told}{mark} | {change} | {forms} |")
    return "\n".join(lines)


def _hidden(row: Row) -> tuple[str, float, int]:
    names = [row["beside"]] if "beside" in row else []
    names += row.get("laws_hidden") or [row.get("law") or f"{row['foreign']} (not our needle)"]
    return " + ".join(names), row.get("size", 1.0), row["seed"]


def beside_it(row: Row) -> str:
    """Effects of the library that are named, too."""
    return f", with {', '.join(row['library'])}" if row["library"] else ""


CAMPAIGN = Campaign(__doc__, plan, ask, table, size=3, counts="seeds of each law and size (3)")
