from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from needle_rig.control.reports import SettledMotion
from needle_rig.control.strategies.estimator import Estimator
from needle_rig.control.strategies.none import NoCompensation
from needle_rig.control.strategy import History, Strategy, Task, Waypoint
from needle_rig.errors import BadInput
from needle_rig.model import EXPERIMENT_LAYOUT, load_parameters
from needle_rig.service.thinker import Thinker
from needle_rig.units import rad

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

    slow = True

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


@pytest.fixture
def thinker() -> Iterator[Thinker]:
    thinker = Thinker()
    yield thinker
    thinker.close()
    thinker.close()


def process_of(thinker: Thinker) -> str:
    """The process that a slow strategy thinks in."""
    waypoint = thinker(WhoAmI(), TASK, HISTORY).result(60)
    assert waypoint is not None
    return waypoint.name


def test_quick_strategies_answer_at_once(thinker: Thinker) -> None:
    answer = thinker(NoCompensation(), TASK, HISTORY[:1])
    assert answer.done()
    assert answer.result() == Waypoint(rad(45.0), "rotate")


def test_slow_strategies_think_in_one_other_process(thinker: Thinker) -> None:
    first, second = (process_of(thinker) for _ in range(2))
    assert first == second != str(os.getpid())
    with pytest.raises(BadInput, match="no plan for this"):
        thinker(Refuses(), TASK, HISTORY).result(60)


def test_a_child_that_died_is_replaced(thinker: Thinker) -> None:
    first = process_of(thinker)
    assert thinker(Dies(), TASK, HISTORY).exception(60) is not None
    assert process_of(thinker) != first


def test_the_estimator_and_a_model_cross_to_the_other_process_unharmed(thinker: Thinker) -> None:
    from dataclasses import replace

    task = replace(TASK, model=load_parameters("rig_elastic"))
    answer = thinker(Estimator(), task, HISTORY).result(60)
    assert answer == Estimator().next(task, HISTORY)
