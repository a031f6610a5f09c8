"""Whatever a strategy says or raises, a sequence goes on within the rig's limits or ends by one sentence."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.control.checked import NAME_LETTERS, NOTE_LETTERS, Checked
from needle_rig.control.compensation import ACTIVE
from needle_rig.control.ranges import MOST_MOTIONS, SETTLE_S, SLOWEST_RAD_S
from needle_rig.control.reports import Outcome, Request
from needle_rig.control.strategy import (
    Dither,
    History,
    Reason,
    SettledMotion,
    Strategy,
    Task,
    Waypoint,
    make_strategy,
    sentence,
    shipped_strategies,
)
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.model import EXPERIMENT_LAYOUT
from needle_rig.records import Phase
from needle_rig.units import rad
from tests.unit.control.test_manual import ready
from tests.unit.control.test_reference import Node

TASK = Task(
    target_rad=0.5,
    layout=EXPERIMENT_LAYOUT,
    torsional_rigidity_nm2=62.56e-6,
    speed_rad_s=rad(45.0),
    settle_s=1.0,
    angle_limit_rad=rad(720.0),
    velocity_limit_rad_s=rad(60.0),
    tick_hz=200.0,
)


def settled(number: int, base_rad: float = 0.0, time_s: float = 0.0) -> SettledMotion:
    return SettledMotion(number, "", time_s, time_s, base_rad, base_rad, 0.0, (0.0,) * 4, 0.0, 0.0)


REST = (settled(0),)


@dataclass(frozen=True)
class Says(Strategy):
    """Says what the test tells it to."""

    say: Callable[[History], Any]
    expected: Callable[[], Any] = lambda: 1
    judged: Callable[[], Any] = lambda: None
    extra: Callable[[], Any] = lambda: 0.0

    def next(self, task: Task, history: History) -> Waypoint | None:
        answer: Waypoint | None = self.say(history)
        return answer

    def check(self, task: Task) -> None:
        self.judged()

    def extra_used_deg(self, task: Task) -> float:
        extra: float = self.extra()
        return extra

    def expected_motions(self) -> int:
        expected: int = self.expected()
        return expected


def moves(*values: Any, **named: Any) -> Callable[[History], Any]:
    return lambda history: Waypoint(*values, **named) if len(history) == 1 else None


def raises(error: BaseException) -> Callable[..., Any]:
    def raised(*_: Any) -> Any:
        raise error

    return raised


def dithers(amplitude: Any, frequency: Any, angle_rad: float = 0.5) -> Callable[[History], Any]:
    return moves(angle_rad, "m", dither=Dither(amplitude, frequency))


class Unreadable:
    def __repr__(self) -> str:
        raise ValueError


class OddError(Exception):
    def __str__(self) -> str:
        raise ValueError


class OddRefusal(NeedleRigError):
    def __init__(self, first: str, second: str) -> None:
        super().__init__(first + second)


class Lazy(Waypoint):
    @property
    def angle_rad(self) -> float:
        raise RuntimeError("not yet")

    def __init__(self) -> None:
        pass


WRONG: dict[str, tuple[Callable[[History], Any], str]] = {
    "angle nan": (moves(math.nan, "m"), "the base angle of motion m is nan, not a finite number"),
    "angle inf": (moves(math.inf, "m"), "the base angle of motion m is inf, not a finite number"),
    "angle text": (moves("45", "m"), "the base angle of motion m is '45', not a finite number"),
    "angle None": (moves(None, "m"), "the base angle of motion m is None, not a finite number"),
    "angle complex": (moves(1 + 1j, "m"), r"is \(1\+1j\), not a finite number"),
    "angle array": (moves(np.array([1.0, 2.0]), "m"), r"is array\(.*, not a finite number"),
    "angle of an array of one": (moves(np.array(1.0), "m"), "not a finite number"),
    "angle True": (moves(True, "m"), "is True, not a finite number"),
    "angle NumPy's True": (moves(np.True_, "m"), "True.*, not a finite number"),
    "angle of 400 digits": (moves(10**400, "m"), "not a finite number"),
    "angle unreadable": (moves(Unreadable(), "m"), "motion m is a Unreadable, not a finite number"),
    "angle raises": (lambda _: Lazy(), "failed with"),
    "angle beyond": (moves(rad(721.0), "m"), r"base angle of 721\.0° in motion m, outside ±720°"),
    "speed nan": (moves(0.5, "m", math.nan), "the speed of motion m is nan, not a finite number"),
    "speed 0": (moves(0.5, "m", 0.0), "in motion m the speed 0°/s is outside 0.1 to 60°/s"),
    "speed -1": (moves(0.5, "m", -1.0), r"in motion m the speed -57\.2958°/s is outside 0.1 to 60°/s"),
    "speed too slow": (moves(0.5, "m", rad(0.09)), r"the speed 0\.09°/s is outside"),
    "speed inf": (moves(0.5, "m", math.inf), "the speed of motion m is inf"),
    "speed 1e9": (moves(0.5, "m", 1e9), "is outside 0.1 to 60°/s"),
    "speed text": (moves(0.5, "m", "x"), "the speed of motion m is 'x'"),
    "settle nan": (moves(0.5, "m", None, math.nan), "the settling time of motion m is nan"),
    "settle -1": (moves(0.5, "m", None, -1.0), r"the settling time -1\.0 s is outside 0.1 to 600 s"),
    "settle inf": (moves(0.5, "m", None, math.inf), "the settling time of motion m is inf"),
    "settle too long": (moves(0.5, "m", None, 601), "the settling time 601.0 s is outside"),
    "dither 30° 5 Hz": (dithers(rad(30.0), 5.0), "the dither of motion m turns at up to 942°/s, limit 60°/s"),
    "dither 1e9": (dithers(1e9, 5.0), "the dither of motion m turns at up to"),
    "dither nan": (dithers(math.nan, 5.0), "the amplitude of the dither of motion m is nan"),
    "dither -1°": (dithers(-rad(1.0), 5.0), "the amplitude of the dither of motion m is -1°, limit 0°"),
    "dither of nan Hz": (dithers(0.01, math.nan), "the frequency of the dither of motion m is nan"),
    "dither of 1 MHz": (dithers(0.01, 1e6), r"is 1e\+06 Hz, outside 0 to 50 Hz \(tick_hz/4\)"),
    "dither of 0 Hz": (dithers(0.01, 0.0), "is 0 Hz, outside 0 to 50 Hz"),
    "dither at the limit": (dithers(rad(8.0), 1.0, rad(715.0)), r"715\.0° ± 8° in motion m, outside ±720°"),
    "dither text": (moves(0.5, "m", dither="x"), "the dither of motion m is 'x', not a Dither or None"),
    "name huge": (moves(0.5, "m" * 100_000), f"a printable text of up to {NAME_LETTERS} letters"),
    "name None": (moves(0.5, None), "the name of motion 1 is None, not a printable text"),
    "name nul": (moves(0.5, "a\0b"), "the name of motion 1 is .*, not a printable text"),
    "name empty": (moves(0.5, ""), "motion 1 has no name; give it one of letters"),
    "name blank": (moves(0.5, "  "), "motion 1 has no name"),
    "note None": (moves(0.5, "m", note=None), "the note of motion m is None, not a printable text"),
    "note huge": (moves(0.5, "m", note="n" * 501), f"a printable text of up to {NOTE_LETTERS} letters"),
    "reason text": (moves(0.5, "m", reason="strategy"), "the reason of motion m is 'strategy', not a Reason"),
    "a number": (lambda _: 45, "motion 1 is 45, not a Waypoint or None"),
    "a tuple": (lambda _: (1, 2), r"motion 1 is \(1, 2\), not a Waypoint or None"),
    "False": (lambda _: False, "motion 1 is False, not a Waypoint or None"),
    "raises RecursionError": (raises(RecursionError("deep")), "failed with RecursionError: deep"),
    "raises SystemExit": (raises(SystemExit(3)), "failed with SystemExit: 3; choose another"),
    "raises KeyboardInterrupt": (raises(KeyboardInterrupt()), "failed with KeyboardInterrupt"),
    "raises MemoryError": (raises(MemoryError()), "failed with MemoryError"),
    "raises StopIteration": (raises(StopIteration()), "failed with StopIteration"),
    "raises GeneratorExit": (raises(GeneratorExit()), "failed with GeneratorExit"),
    "raises what cannot be told": (raises(OddError()), "failed with OddError: a OddError; choose another"),
    "raises a line break": (raises(ValueError("a\nb")), "failed with ValueError: a b; choose another"),
    "raises a book": (raises(ValueError("x" * 10**6)), "x…; choose another"),
    "refuses": (raises(BadInput("no plan; turn less")), "^no plan; turn less$"),
    "refuses oddly": (raises(OddRefusal("no ", "plan")), "^no plan$"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_answer_is_one_sentence(case: str) -> None:
    say, told = WRONG[case]
    with pytest.raises((BadInput, RigFault), match=told) as refused:
        Checked.of(Says(say)).next(TASK, REST)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 1000
    assert case.startswith("refuses") or "strategy Says" in str(refused.value)


RIGHT = [
    Waypoint(0.5, "m"),
    Waypoint(rad(720.0), "m", rad(0.1), 0.1),
    Waypoint(-rad(720.0), "m" * NAME_LETTERS, rad(60.0), 600.0, note="n" * NOTE_LETTERS),
    Waypoint(rad(712.0), "m", dither=Dither(rad(8.0), 1.0), reason=Reason.MODEL_DOUBTED),
    Waypoint(0.0, "m", dither=Dither(rad(0.1), 50.0)),
    Waypoint(0.0, "m", dither=Dither(0.0, 1.0)),
]


@pytest.mark.parametrize("waypoint", RIGHT)
def test_what_the_rig_can_do_stays_as_it_is(waypoint: Waypoint) -> None:
    assert Checked.of(Says(lambda _: waypoint)).next(TASK, REST) == waypoint


@pytest.mark.parametrize("value", [1, np.float64(1.0), np.float32(1.0), np.int8(1), Fraction(1)])
def test_numbers_of_other_kinds_become_plain_ones(value: Any) -> None:
    dither = Dither(value, value)
    asked = replace(TASK, velocity_limit_rad_s=math.tau)
    told = Checked.of(Says(moves(value, "m", value, value, dither))).next(asked, REST)
    assert told == Waypoint(1.0, "m", 1.0, 1.0, Dither(1.0, 1.0))
    assert type(told.angle_rad) is type(told.speed_rad_s) is type(told.settle_s) is float


def test_a_sequence_has_only_so_many_motions() -> None:
    strategy = Checked.of(Says(lambda history: Waypoint(0.1 * (len(history) % 2), "again")))
    history = tuple(settled(k) for k in range(MOST_MOTIONS))
    assert strategy.next(TASK, history) is not None
    with pytest.raises(BadInput, match=f"it goes on after {MOST_MOTIONS} motions, the most of one sequence"):
        strategy.next(TASK, (*history, settled(MOST_MOTIONS)))


def test_a_sequence_lasts_only_so_long() -> None:
    longest_s = MOST_MOTIONS * SETTLE_S[1] + 2.0 * TASK.angle_limit_rad / SLOWEST_RAD_S
    strategy = Checked.of(Says(lambda _: Waypoint(1.0, "last", 0.1, 20.0)))
    within, beyond = ((settled(0), settled(1, 0.0, longest_s - left_s)) for left_s in (30.1, 29.9))
    assert strategy.next(TASK, within) is not None
    with pytest.raises(BadInput, match=r"with motion last the sequence lasts 37\.3 h, limit 37\.3 h"):
        strategy.next(TASK, beyond)


def test_the_longest_list_of_steps_fits_into_a_sequence() -> None:
    # to and fro would not at the slowest speed; one way through the range with the longest rests does
    far = np.linspace(-720.0, 720.0, MOST_MOTIONS)
    protocol = Checked.of(
        make_strategy("protocol", {"steps_deg": tuple(far), "speed_deg_s": 0.1, "dwell_s": SETTLE_S[1]})
    )
    history: History = (settled(0, rad(-720.0)),)
    time_s = 0.0
    while (waypoint := protocol.next(TASK, history)) is not None:
        assert waypoint.speed_rad_s is not None
        assert waypoint.settle_s is not None
        travel_s = abs(waypoint.angle_rad - history[-1].base_angle_rad) / waypoint.speed_rad_s
        time_s += travel_s + waypoint.settle_s
        history = (*history, settled(len(history), waypoint.angle_rad, time_s))
    assert len(history) - 1 == MOST_MOTIONS


NOT_COUNTS = [raises(SystemExit()), lambda: None, lambda: "5", lambda: -1, lambda: math.nan, lambda: True]


@pytest.mark.parametrize("say", NOT_COUNTS)
def test_what_is_asked_before_anything_moves_is_checked_as_well(say: Callable[[], Any]) -> None:
    brain = ready().brain
    for strategy in (
        Says(moves(0.5, "m"), expected=say),
        Says(moves(0.5, "m"), judged=raises(KeyboardInterrupt())),
        Says(moves(0.5, "m"), extra=lambda: math.inf),
        Says(moves(0.5, "m"), extra=raises(MemoryError())),
    ):
        with pytest.raises((BadInput, RigFault), match="strategy Says"):
            brain.compensate(Request(0.5, strategy))
    assert brain.state.phase is Phase.IDLE


OPTIONS = [math.nan, math.inf, -math.inf, "5", 1e9, 10**400, [1.0], 1j, {}, object(), b"1", True]


@pytest.mark.parametrize("value", OPTIONS)
def test_an_option_that_is_no_number_of_its_kind_is_one_sentence(value: Any) -> None:
    with pytest.raises(BadInput, match=r"give|choose|must be") as refused:
        make_strategy("decay", {"ratio": value})
    assert len(str(refused.value)) < 300
    with pytest.raises(BadInput, match="give"):
        make_strategy("protocol", {"steps_deg": [0.0, value]})
    if value != [1.0]:
        with pytest.raises(BadInput, match="give"):
            make_strategy("protocol", {"steps_deg": [0.0], "speed_deg_s": value})


def test_more_values_than_a_sequence_has_motions_are_refused() -> None:
    with pytest.raises(BadInput, match=f"option steps_deg has 201 values; give up to {MOST_MOTIONS}"):
        make_strategy("protocol", {"steps_deg": [0.0] * 201})


class Bench(Node):
    """The production brain with a base that goes where it is told."""

    reach_rad = 0.0

    def run(self, strategy: Strategy, limit_s: float = 60.0) -> Outcome:
        self.ticks(3)
        self.brain.compensate(Request(0.0, strategy, settle_s=0.1, speed_rad_s=rad(20.0)))
        start_s = self.time_s
        while self.brain.state.phase in ACTIVE:
            self.tick()
            self.reach_rad = max(self.reach_rad, abs(self.true_rad))
            assert self.time_s - start_s < limit_s
        outcome = self.brain.state.outcome
        assert outcome is not None
        return outcome


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_answer_ends_the_sequence_and_the_next_order_is_taken(case: str) -> None:
    bench = Bench()
    ended = bench.run(Says(WRONG[case][0]))
    assert (ended.status, ended.fault_name) == ("fault", "control")
    assert bench.reach_rad < rad(0.1)
    assert bench.run(Says(moves(rad(2.0), "m"))).status in ("aligned", "not_aligned")
    assert bench.true_rad == pytest.approx(rad(2.0), abs=rad(0.1))


def endless() -> Iterator[Waypoint]:
    return (Waypoint(rad(0.2 * (k % 2)), "again", rad(60.0), 0.1) for k in itertools.count())


@pytest.mark.whole
def test_endless_motions_end() -> None:
    bench = Bench()
    motions = endless()
    ended = bench.run(Says(lambda _: next(motions)), limit_s=600.0)
    assert ended.fault_name == "control"
    assert f"goes on after {MOST_MOTIONS} motions" in ended.text
    assert len(bench.brain.settled) == MOST_MOTIONS


@pytest.mark.parametrize("name", [None, 5, "", "x" * 1000, "a\nb", Unreadable()])
def test_odd_names_of_a_strategy_raise_in_no_tick(name: Any) -> None:
    class Odd(Says):
        pass

    Odd.name = name
    bench = Bench()
    ended = bench.run(Odd(moves(rad(1.0), "m")))
    assert ended.strategy == "Odd"


def test_a_name_that_raises_is_none() -> None:
    class Odd(Says):
        @property
        def name(self) -> str:  # type: ignore[override]
            raise SystemExit

    assert Bench().run(Odd(moves(rad(1.0), "m"))).strategy == "Odd"


ANYTHING = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.complex_numbers(),
    st.text(max_size=70),
    st.binary(max_size=5),
    st.lists(st.floats(), max_size=3),
    st.just(Unreadable()),
    st.builds(object),
)
NUMBERISH = st.one_of(ANYTHING, st.floats(-15.0, 15.0), st.floats(0.0, 1.0), st.floats(0.0, 700.0))
DITHERS = st.one_of(ANYTHING, st.builds(Dither, NUMBERISH, NUMBERISH))
WAYPOINTS = st.builds(
    Waypoint,
    NUMBERISH,
    st.one_of(ANYTHING, st.just("m")),
    NUMBERISH,
    NUMBERISH,
    DITHERS,
    st.one_of(ANYTHING, st.sampled_from(Reason)),
    st.one_of(ANYTHING, st.just("")),
)
LIKELY = st.builds(
    Waypoint,
    st.floats(-13.0, 13.0),
    st.just("m"),
    st.one_of(st.none(), st.floats(0.0, 1.2)),
    st.one_of(st.none(), st.floats(0.0, 700.0)),
    st.one_of(st.none(), st.builds(Dither, st.floats(-0.1, 0.5), st.floats(0.0, 60.0))),
)


@pytest.mark.whole
@given(st.one_of(ANYTHING, WAYPOINTS, LIKELY))
def test_any_object_is_refused_or_within_the_limits(answer: Any) -> None:
    try:
        told = Checked.of(Says(lambda _: answer)).next(TASK, REST)
    except (BadInput, RigFault):
        return
    if told is None:
        assert answer is None
        return
    dither = told.dither or Dither(0.0, 1.0)
    assert abs(told.angle_rad) + dither.amplitude_rad <= TASK.angle_limit_rad
    assert 0.0 < dither.frequency_hz <= TASK.tick_hz / 4
    assert dither.amplitude_rad * math.tau * dither.frequency_hz <= TASK.velocity_limit_rad_s
    speed_rad_s, settle_s = TASK.pace(told)
    assert SLOWEST_RAD_S <= speed_rad_s <= TASK.velocity_limit_rad_s
    assert SETTLE_S[0] <= settle_s <= SETTLE_S[1]
    assert 0 < len(told.name) <= NAME_LETTERS


@pytest.mark.parametrize("name", sorted(shipped_strategies()))
def test_a_strategy_says_what_it_does_without_the_names_of_its_options(name: str) -> None:
    kind = shipped_strategies()[name]
    told = sentence(kind)
    assert told.endswith(".")
    assert "`" not in told
    assert not {field.name for field in fields(kind)} & set(re.findall(r"\w+", told))  # type: ignore[arg-type]
