"""Runs plans: a healthy sequence, and copies of the whole process in which something breaks."""

from __future__ import annotations

import json
import os
import random
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

from campaigns.rig.hazard.cases import Case
from campaigns.rig.hazard.plans import Plan
from campaigns.rig.hazard.scenes import SCENES
from campaigns.rig.hazard.setups import SETUPS
from campaigns.rig.hazard.trial import Result, Trial, aftermath

LONGEST_S, ALREADY_DONE_S, HELD_S = 60.0, 0.5, 1.5
"""A healthy run; how long to stay after it; how long a hold is looked at."""
AFTER_S = 1.5
"""How long to look once a healthy run would have ended."""


@dataclass(frozen=True)
class Found:
    """A case and what became of it; `cpu_s` is the processor time of its copy."""

    case: Case
    result: Result
    cpu_s: float

    def line(self) -> str:
        """As JSON."""
        return json.dumps({"case": self.case.text, "cpu_s": round(self.cpu_s, 3), **asdict(self.result)})

    @classmethod
    def parse(cls, line: str) -> Found:
        """From a line. Raises ValueError."""
        told = json.loads(line)
        case, cpu_s = Case.parse(told.pop("case")), told.pop("cpu_s")
        return cls(case, Result(**told), cpu_s)


@dataclass(frozen=True)
class Lame:
    """A healthy rig that did not get through its scene: nothing could be broken in it."""

    setup: str
    speed_deg_s: float
    fault: str


def results(plan: Plan) -> Iterator[Found | Lame]:
    """Every trial of `plan`."""
    told = in_a_copy(lambda: scout(plan))
    if told["fault"] or told["end_s"] is None:
        yield Lame(plan.setup, plan.speed_deg_s, told["fault"] or "it does not end")
        return
    chance = random.Random(f"{plan.seed} {plan.scene}")
    planned = []
    for kind, place, breaks in plan.places:
        ticks = _ticks(told["places"], place)
        if ticks:
            planned.append((chance.choice(ticks), kind, breaks))
    trial = start(plan.setup, plan.scene, plan.speed_deg_s, plan.seed)
    for tick, kind, breaks in sorted(planned, key=lambda one: one[0]):
        while trial.ticks < tick:
            trial.tick()
        left_s = max(told["end_s"] - trial.time_s, 0.0) + AFTER_S
        for broken in breaks:
            case = Case(
                kind,
                plan.setup,
                plan.scene,
                plan.speed_deg_s,
                plan.seed,
                tick,
                broken,
                told["places"][tick - 1],
            )
            told_result = in_a_copy(lambda: _result(trial, case, left_s))  # noqa: B023
            yield Found(case, Result(**told_result["result"]), told_result["cpu_s"])


def start(setup: str, scene: str, speed_deg_s: float, seed: int) -> Trial:
    """A healthy rig."""
    return Trial(SETUPS[setup], SCENES[scene], speed_deg_s, seed)


def until(case: Case) -> Trial:
    """The healthy rig of `case` at the instant at which it breaks."""
    trial = start(case.setup, case.scene, case.speed_deg_s, case.seed)
    while trial.ticks < case.tick:
        trial.tick()
    return trial


def broken(trial: Trial, case: Case, left_s: float) -> Result:
    """What becomes of `trial`; its chance is that of `case`."""
    trial.random.seed(case.text)
    left_s = SCENES[case.scene].left_s or left_s
    return aftermath(trial, case.injections, case.watch_s, left_s)


def scout(plan: Plan) -> dict[str, Any]:
    """Where a healthy rig is after each tick, `seam` where a motion ended and the next began, and when it is
    done."""
    trial = start(plan.setup, plan.scene, plan.speed_deg_s, plan.seed)
    places: list[str] = []
    motion, end_s = 0, None
    long = bool(SCENES[plan.scene].left_s)
    while end_s is None or trial.time_s < end_s:
        trial.tick()
        state = trial.brain.state
        if state.fault_name is not None and trial.orders_given:
            return {"places": places, "end_s": None, "fault": f"{state.fault_name}: {state.fault}"}
        seam = state.motion_index > motion and state.phase.value == "moving"
        motion = state.motion_index
        places.append("seam" if seam else trial.place())
        if end_s is None and places[-1] in ("done", "holding"):
            end_s = trial.time_s + (HELD_S if places[-1] == "holding" else ALREADY_DONE_S)
        if end_s is None and long and motion:
            end_s = trial.time_s
        if trial.time_s > LONGEST_S:
            break
    return {"places": places, "end_s": end_s, "fault": ""}


def _ticks(places: list[str], wanted: str) -> list[int]:
    """The ticks at the end of which a fault may begin at this place."""
    if wanted == "any":
        return [n for n, place in enumerate(places, 1) if place != "before"]
    if wanted == "ordered":
        return [len(places)]
    return [n for n, place in enumerate(places, 1) if place == wanted]


def _result(trial: Trial, case: Case, left_s: float) -> dict[str, Any]:
    result = broken(trial, case, left_s)
    return {"result": asdict(result), "cpu_s": time.process_time()}


def in_a_copy(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What `work` gives in a fork of this process, of which nothing else remains."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.close(reader)
            with os.fdopen(writer, "w") as pipe:
                json.dump(work(), pipe)
            code = 0
        except BaseException:
            traceback.print_exc()
            raise
        finally:
            os._exit(code)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        text = pipe.read()
    if os.waitpid(child, 0)[1] != 0:
        raise RuntimeError("a trial failed; its error is above")
    told: dict[str, Any] = json.loads(text)
    return told
