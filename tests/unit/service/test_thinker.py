from __future__ import annotations

import asyncio
import multiprocessing
import os
import time
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from needle_rig.config.python_file import load_module
from needle_rig.control.manual import Turn
from needle_rig.control.strategies.estimator import Estimator
from needle_rig.control.strategies.none import NoCompensation
from needle_rig.control.strategies.planned import Planned
from needle_rig.control.strategy import History, SettledMotion, Strategy, Task, Waypoint, find_strategies
from needle_rig.errors import BadInput, RigFault
from needle_rig.model import EXPERIMENT_LAYOUT, load_parameters
from needle_rig.physics.library import find_effects, load_effect
from needle_rig.service.tick.thinker import QUICK, Thinker
from needle_rig.units import rad
from needle_rig.workbench.laws.draft import Origin, Table, written
from needle_rig.workbench.laws.law import Law
from tests.effects.common import SHORT
from tests.values import now

TASK = Task(
    target_rad=rad(45.0),
    layout=EXPERIMENT_LAYOUT,
    torsional_rigidity_nm2=62.56e-6,
    speed_rad_s=rad(45.0),
    settle_s=3.0,
)


def settled(index: int, time_s: float, base_deg: float, torque_nm: float) -> SettledMotion:
    base = rad(base_deg)
    return SettledMotion(index, "", time_s - 4.0, time_s, base, base, torque_nm, (0.0,), 0.0, 0.0)


HISTORY = (settled(0, 0.5, 0.0, 0.0), settled(1, 5.0, 45.0, 1e-4))


@dataclass(frozen=True)
class WhoAmI(Strategy):
    """Tells the process that it thinks in."""

    def next(self, task: Task, history: History) -> Waypoint:
        return Waypoint(0.0, str(os.getpid()))


@dataclass(frozen=True)
class Refuses(WhoAmI):
    def next(self, task: Task, history: History) -> Waypoint:
        raise BadInput("no plan for this")


@dataclass(frozen=True)
class Dies(WhoAmI):
    def next(self, task: Task, history: History) -> Waypoint:
        os._exit(1)


@dataclass(frozen=True)
class Hangs(WhoAmI):
    def next(self, task: Task, history: History) -> Waypoint:
        while True:
            time.sleep(0.01)


@dataclass(frozen=True)
class Backwards(WhoAmI):
    def next(self, task: Task, history: History) -> Waypoint:
        return Waypoint(0.5, "m", speed_rad_s=-1.0)


@dataclass(frozen=True)
class Ends(WhoAmI):
    def next(self, task: Task, history: History) -> Waypoint:
        raise SystemExit(3)


@dataclass(frozen=True)
class TellsTorque(WhoAmI):
    def next(self, task: Task, history: History) -> Waypoint:
        assert task.model is not None
        return Waypoint(float(task.model.predict(SHORT).torque_nm[-1]), "torque")


@pytest.fixture
def thinker() -> Iterator[Thinker]:
    thinker = Thinker()
    yield thinker
    thinker.close()
    thinker.close()


def asked(thinker: Thinker, strategy: Strategy, task: Task = TASK) -> Future[Waypoint | None]:
    answer = thinker(strategy, task, HISTORY)
    assert isinstance(answer, Future)
    return answer


def process_of(thinker: Thinker) -> int:
    """The process that a strategy thinks in which is not known to be quick."""
    waypoint = asked(thinker, WhoAmI()).result(60)
    assert waypoint is not None
    return int(waypoint.name)


def thinkers() -> list[int | None]:
    return [p.pid for p in multiprocessing.active_children() if p.name == "thinker"]


def gone(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state == "Z"


def test_quick_strategies_answer_at_once(thinker: Thinker) -> None:
    assert thinker(NoCompensation(), TASK, HISTORY[:1]) == Waypoint(rad(45.0), "rotate")


def test_every_shipped_strategy_is_quick_but_those_that_solve_models() -> None:
    assert {*find_strategies().values(), Turn} - QUICK == {Estimator, Planned}


def test_other_strategies_think_in_one_other_process(thinker: Thinker) -> None:
    first, second = (process_of(thinker) for _ in range(2))
    assert first == second != os.getpid()
    with pytest.raises(BadInput, match="no plan for this"):
        asked(thinker, Refuses()).result(60)


@pytest.mark.whole
def test_a_child_that_died_is_replaced(thinker: Thinker) -> None:
    first = process_of(thinker)
    with pytest.raises(RigFault, match="strategy Dies lost its process; choose another"):
        asked(thinker, Dies()).result(60)
    assert process_of(thinker) != first


@pytest.mark.whole
def test_a_strategy_that_never_answers_is_told_by_name_and_its_process_replaced() -> None:
    thinker = Thinker(limit_s=10.0)
    first = process_of(thinker)
    thinker._limit_s = 0.5
    with pytest.raises(RigFault, match=r"strategy Hangs has not answered for 0\.5 s .*; choose another"):
        asked(thinker, Hangs()).result(60)
    assert gone(first)
    thinker._limit_s = 60.0
    assert process_of(thinker) != first
    thinker.close()


def test_an_answer_that_nobody_waits_for_is_dropped(thinker: Thinker) -> None:
    first = process_of(thinker)
    lost = asked(thinker, Hangs())
    assert now(thinker.thinking)
    thinker.drop()
    assert not now(thinker.thinking)
    assert process_of(thinker) != first
    assert gone(first)
    assert lost.done()


@pytest.mark.whole
def test_a_process_that_thinks_no_more_is_kept(thinker: Thinker) -> None:
    first = process_of(thinker)
    thinker.drop()
    assert process_of(thinker) == first


@pytest.mark.whole
async def test_the_child_is_started_before_the_first_question_where_one_will_be_needed() -> None:
    thinker = Thinker()
    await thinker.get_ready("reed2008")
    assert thinkers() == []
    await thinker.get_ready("planned")
    (child,) = thinkers()
    answer = asked(thinker, WhoAmI())
    assert await asyncio.wrap_future(answer) == Waypoint(0.0, str(child))
    thinker.close()


def test_a_question_dropped_before_its_child_started_costs_none(thinker: Thinker) -> None:
    for _ in range(20):
        asked(thinker, Hangs())
        thinker.drop()
    assert process_of(thinker)
    assert len(thinkers()) == 1


def test_closing_takes_less_than_a_second_also_while_it_thinks(thinker: Thinker) -> None:
    child = process_of(thinker)
    asked(thinker, Hangs())
    time.sleep(0.2)
    start_s = time.monotonic()
    thinker.close()
    assert time.monotonic() - start_s < 1.0
    while not gone(child):
        assert time.monotonic() - start_s < 10.0


def test_what_cannot_cross_is_a_sentence(thinker: Thinker) -> None:
    @dataclass(frozen=True)
    class Local(WhoAmI):
        pass

    with pytest.raises(RigFault, match="strategy Local cannot be asked in another process: "):
        asked(thinker, Local()).result(60)


def test_what_a_strategy_answers_is_checked_in_the_child(thinker: Thinker) -> None:
    with pytest.raises(BadInput, match=r"strategy Backwards: in motion m the speed -57\.2958°/s is outside"):
        asked(thinker, Backwards()).result(60)
    with pytest.raises(RigFault, match="strategy Ends failed with SystemExit: 3; choose another"):
        asked(thinker, Ends()).result(60)


OWN_STRATEGY = """
from dataclasses import dataclass
from needle_rig.control.strategy import Strategy, Waypoint

@dataclass(frozen=True)
class Own(Strategy):
    by_rad: float = 0.25
    def next(self, task, history):
        return Waypoint(self.by_rad, "own")
    def expected_motions(self):
        return 1
"""


def test_a_strategy_of_a_file_outside_the_package_crosses(thinker: Thinker, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN_STRATEGY)
    own = load_module(tmp_path / "own.py").Own(0.5)
    assert asked(thinker, own).result(60) == Waypoint(0.5, "own")
    os.utime(tmp_path / "own.py", (1, 1))
    thinker.close()
    fresh = Thinker()
    with pytest.raises(BadInput, match=r"own\.py has changed since it was read; start anew"):
        asked(fresh, own).result(60)
    fresh.close()


SLIT = Path(__file__).parents[2] / "data" / "effects" / "slit_membrane.py"


@pytest.mark.parametrize("kind", ["own", "learnt", "shipped"])
def test_every_kind_of_effect_crosses(thinker: Thinker, tmp_path: Path, kind: str) -> None:
    model = load_parameters("rig_rigid")
    if kind == "shipped":
        effect = find_effects()["chuck_backlash"].at_strength(1.0)
    else:
        path = tmp_path / "mine.py"
        if kind == "learnt":
            curve = Table(np.array([0.0, 45.0]), np.array([0.0, 0.01]))
            written(path, Law("observe", "torque", "angle"), curve, Origin("here", "0" * 64, "today"), ())
        else:
            path.write_text(SLIT.read_text())
        effect = load_effect(path).at_strength(1.0)
    model = model.with_effects(effect)
    there = asked(thinker, TellsTorque(), replace(TASK, model=model)).result(60)
    assert there == TellsTorque().next(replace(TASK, model=model), HISTORY)


def test_the_estimator_and_a_model_cross_to_the_other_process_unharmed(thinker: Thinker) -> None:
    task = replace(TASK, model=load_parameters("rig_elastic"))
    assert asked(thinker, Estimator(), task).result(60) == Estimator().next(task, HISTORY)
