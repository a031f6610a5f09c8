"""Jog, home, hold and release, and what stops them; other masters, emergency stop, a host that is late."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from needle_rig.control.faults import FaultName
from needle_rig.control.manual import SETTLE_S
from needle_rig.control.reports import Request
from needle_rig.errors import BadInput, RigFault
from needle_rig.records import RELEASE, STOP, DriveState, Phase
from needle_rig.units import deg, rad
from tests.unit.control.test_reference import CONFIG, TICK_S, Node
from tests.values import now


def ready() -> Node:
    node = Node()
    node.ticks(3)
    return node


def until_over(node: Node, limit_s: float = 60.0) -> None:
    start_s = node.time_s
    while node.brain.state.phase not in (Phase.DONE, Phase.FAULT, Phase.ABORTED):
        node.tick()
        assert node.time_s - start_s < limit_s


@pytest.mark.parametrize("by_deg", [5.0, -90.0, 0.3])
def test_a_jog_turns_by_what_was_asked_and_lets_the_drive_rest(by_deg: float) -> None:
    node = ready()
    node.brain.jog(by_rad=rad(30.0))
    until_over(node)
    node.brain.jog(by_rad=rad(by_deg), speed_rad_s=rad(20.0))
    fastest = 0.0
    while node.brain.state.phase is not Phase.DONE:
        node.tick()
        fastest = max(fastest, abs(node.command.velocity_rad_s))
    assert deg(node.true_rad) == pytest.approx(30.0 + by_deg, abs=0.11)
    assert deg(fastest) <= 20.0 + 1e-9
    node.ticks(2)
    assert node.command == STOP
    assert node.brain.state.outcome is None


def test_a_jog_to_an_angle_and_home() -> None:
    node = ready()
    node.brain.jog(to_rad=rad(120.0))
    until_over(node)
    assert deg(node.true_rad) == pytest.approx(120.0, abs=0.11)
    node.brain.home()
    until_over(node)
    assert deg(node.true_rad) == pytest.approx(0.0, abs=0.11)
    assert node.time_s < 2 * (120 / 45 + 2.0 + SETTLE_S)


def test_what_cannot_be_jogged_is_refused_and_nothing_moves() -> None:
    node = ready()
    for wrong, text in (
        ({}, "give either how far to turn or where to"),
        ({"by_rad": 1.0, "to_rad": 1.0}, "give either"),
        ({"to_rad": rad(721.0)}, "outside ±720°"),
        ({"by_rad": float("nan")}, "not an angle"),
        ({"by_rad": 0.1, "speed_rad_s": rad(61.0)}, "outside 0.1 to 60°/s"),
        ({"by_rad": 0.1, "speed_rad_s": 1e-300}, "outside 0.1 to 60°/s"),
    ):
        with pytest.raises(BadInput, match=text):
            node.brain.jog(**wrong)
    with pytest.raises(BadInput, match="there are angle, hall, index, here"):
        node.brain.home("moon")
    assert node.brain.state.phase is Phase.IDLE
    with pytest.raises(RigFault, match="no reading came yet"):
        Node().brain.jog(by_rad=0.1)


def test_a_held_base_is_kept_where_it_stands_until_it_is_released() -> None:
    node = ready()
    node.brain.jog(by_rad=rad(10.0))
    until_over(node)
    node.brain.hold()
    node.ticks(50)
    assert (node.brain.state.phase, node.brain.state.waiting_for) == (Phase.HOLDING, "a release or a stop")
    assert node.command.enable
    node.encoder_rad += rad(0.5)  # the needle pulls
    node.true_rad += rad(0.5)
    node.ticks(400)
    assert deg(node.encoder_rad) == pytest.approx(10.0, abs=0.12)
    refusals: tuple[Callable[[], object], ...] = (
        lambda: node.brain.compensate(Request(0.5, "none")),
        lambda: node.brain.jog(by_rad=0.1),
        node.brain.hold,
        node.brain.clear,
        lambda: node.brain.home("hall"),
    )
    for refused in refusals:
        with pytest.raises(BadInput, match=r"(release|stop) it first"):
            refused()
    node.brain.release()
    node.tick()
    assert node.command == STOP, "silence in mid-motion is a fault to the drive"
    node.tick()
    assert now(node.command) == RELEASE
    assert node.brain.state.released
    assert node.brain.state.phase is Phase.IDLE


def test_a_released_base_may_be_turned_by_hand_and_then_be_used_again() -> None:
    node = ready()
    node.brain.release()
    node.tick()
    node.state = DriveState.SILENT  # it hears nothing
    for _ in range(100):
        node.encoder_rad += rad(1.0)
        node.true_rad += rad(1.0)
        node.tick()
        assert node.command == RELEASE
    assert node.fault is None
    node.brain.jog(by_rad=rad(-5.0))
    node.tick()
    node.state = DriveState.READY
    until_over(node)
    assert node.fault is None
    assert deg(node.true_rad) == pytest.approx(95.0, abs=0.11)


def test_nothing_is_released_while_a_sequence_runs() -> None:
    node = ready()
    node.brain.compensate(Request(0.5, "none"))
    with pytest.raises(BadInput, match="stop it first"):
        node.brain.release()


@pytest.mark.parametrize("what", ["jog", "hold", "home", "index"])
def test_a_stop_ends_it_in_the_same_tick(what: str) -> None:
    node = ready()
    node.brain.jog(by_rad=rad(30.0))
    until_over(node)
    if what == "index":
        node.reset()
        node.tick()
    begin: dict[str, Callable[[], object]] = {
        "jog": lambda: node.brain.jog(by_rad=rad(90.0)),
        "hold": node.brain.hold,
        "home": node.brain.home,
        "index": lambda: node.brain.home("index"),
    }
    begin[what]()
    node.ticks(60)
    assert node.command.enable
    assert node.brain.stop("a person") == STOP
    for _ in range(400):
        node.tick()
        assert not node.command.enable
    lost = what == "index"
    assert node.brain.state.phase is (Phase.FAULT if lost else Phase.ABORTED)


def test_a_command_of_another_master_latches() -> None:
    node = ready()
    node.brain.compensate(Request(0.5, "none"))
    node.ticks(150)
    node.changes = {"foreign_commands": 2}
    node.tick()
    assert node.command == STOP
    assert now(node.fault) == FaultName.SECOND_MASTER
    assert "another master sent 2 commands" in (node.brain.state.fault or "")
    node.ticks(50)
    assert now(node.fault) == FaultName.SECOND_MASTER
    node.brain.clear()
    node.ticks(5)
    assert now(node.fault) is None, "those were seen"
    node.changes = {"foreign_commands": 3}
    node.tick()
    assert node.fault == FaultName.SECOND_MASTER


def test_the_emergency_stop_latches_and_no_clear_goes_past_it() -> None:
    node = ready()
    node.brain.compensate(Request(0.5, "none"))
    node.ticks(150)
    node.changes = {"emergency_stop": True}
    node.tick()
    assert (node.command, node.fault) == (STOP, FaultName.EMERGENCY_STOP)
    node.brain.clear()
    node.tick()
    assert node.fault == FaultName.EMERGENCY_STOP
    node.changes = {}
    node.tick()
    assert node.fault == FaultName.EMERGENCY_STOP
    node.brain.clear()
    node.tick()
    assert node.fault is None


def late(tick_s: float, ticks_in_time: int = 5, age_s: float = 0.001) -> tuple[Node, float | None]:
    """A link that dies while a host ticks every `tick_s`; after how long the host says so."""
    node = Node(type(ready().brain)(CONFIG.model_copy(update={"links": FIFTY})))
    node.ticks(ticks_in_time)
    for _ in range(4):
        node.time_s += tick_s
        node.brain.step(node.read(), tick_s)
    assert now(node.brain.state.fault) is None, "a slow host alone is no fault"
    dead_s = 0.0
    while now(node.brain.state.fault) is None:
        dead_s += tick_s
        node.time_s += tick_s
        node.changes = {"hall_age_s": age_s + dead_s}
        node.brain.step(node.read(), tick_s)
        if dead_s > 1.0:
            return node, None
    return node, dead_s


FIFTY = CONFIG.links.model_copy(update={f"{link}_age_limit_ms": 50.0 for link in ("torque", "hall", "drive")})


@pytest.mark.parametrize("tick_s", [TICK_S, 0.011, 0.02, 0.03, 0.04, 0.045])
def test_a_dead_link_is_dead_within_its_limit_however_late_the_ticks_come(tick_s: float) -> None:
    node, dead_s = late(tick_s)
    assert dead_s is not None
    assert dead_s <= 0.0501
    name = FaultName.LINK_DEAD if tick_s == TICK_S else FaultName.LATE_TICK
    assert node.fault == name


def test_one_late_tick_among_others_is_forgiven() -> None:
    node = Node(type(ready().brain)(CONFIG.model_copy(update={"links": FIFTY})))
    node.ticks(5)
    node.changes = {"hall_age_s": 0.2}
    node.brain.step(node.read(), 0.2)
    assert node.fault is None
    node.changes = {}
    node.ticks(3)
    assert node.fault is None


@pytest.mark.parametrize(
    ("age_s", "name"),
    [
        (0.001, FaultName.NOT_TURNING),
        (0.021, FaultName.NOT_TURNING),
        (0.0999, FaultName.NOT_TURNING),
        (0.1001, FaultName.BLIND),
    ],
)
def test_an_old_answer_is_held_against_what_had_been_commanded_then(age_s: float, name: FaultName) -> None:
    node = ready()
    node.brain.compensate(Request(0.5, "none"))
    node.ticks(140)
    assert node.command.velocity_rad_s > 0.3
    stood_rad = node.encoder_rad
    node.changes = {"drive_age_s": age_s}
    for _ in range(60):
        node.tick()
        node.encoder_rad = node.true_rad = stood_rad
        if node.fault:
            break
    assert node.fault == name
    assert node.brain.state.latched == (name is FaultName.NOT_TURNING)
    assert not node.command.enable
