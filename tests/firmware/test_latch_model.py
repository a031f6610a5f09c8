"""Host and node together forget no fault: every short history, random long ones, and rigs that do forget."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise, product
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from needle_rig.control import clearing, limits, standing
from needle_rig.control.brain import Brain
from needle_rig.firmware.host import HostNodes
from needle_rig.firmware.sources import firmware_folder
from needle_rig.records import Command, DriveFault, DriveState
from tests.firmware.latch_world import Broken, World

ORDERS = ("clear", "jog", "hold", "release", "stop", "home", "hall", "here", "compensate")
PARTS = tuple(part.name for part in dataclasses.fields(Broken))
SPANS_MS = (1, 3, 5, 20, 45, 60, 101, 130, 300, 1000)


def awake(nodes: HostNodes) -> World:
    """A rig whose links are heard and whose drive is ready."""
    world = World(nodes)
    world.pass_ms(60)
    world.order("clear")
    world.pass_ms(60)
    assert world.state is DriveState.READY
    return world


def histories(nodes: HostNodes) -> type[RuleBasedStateMachine]:
    class Histories(RuleBasedStateMachine):
        """Whatever may happen to a rig and be said to it, in any order."""

        @initialize(delayed=st.booleans())
        def begin(self, delayed: bool) -> None:
            self.world = World(nodes)
            self.world.pass_ms(60)
            if delayed:
                self.world.up_ms = self.world.down_ms = 45

        @rule(what=st.sampled_from(ORDERS), span_ms=st.sampled_from(SPANS_MS))
        def say(self, what: str, span_ms: int) -> None:
            self.world.order(what)
            self.world.pass_ms(span_ms)

        @rule(part=st.sampled_from(PARTS), span_ms=st.sampled_from(SPANS_MS))
        def fail(self, part: str, span_ms: int) -> None:
            setattr(self.world.broken, part, True)
            self.world.pass_ms(span_ms)

        @rule(part=st.sampled_from(PARTS), span_ms=st.sampled_from(SPANS_MS))
        def fail_and_mend(self, part: str, span_ms: int) -> None:
            self.world.fail(part, span_ms)
            self.world.pass_ms(1)

        @rule(span_ms=st.sampled_from(SPANS_MS))
        def mend(self, span_ms: int) -> None:
            self.world.broken = Broken()
            self.world.pass_ms(span_ms)

        @rule(span_ms=st.sampled_from((45, 300)))
        def pause(self, span_ms: int) -> None:
            self.world.pause_ms = span_ms
            self.world.pass_ms(span_ms + 5)

        @rule(up_ms=st.integers(0, 50), down_ms=st.integers(0, 50))
        def delay(self, up_ms: int, down_ms: int) -> None:
            self.world.up_ms, self.world.down_ms = up_ms, down_ms

        @rule(deed=st.sampled_from(("foreign", "damage", "restart")), span_ms=st.sampled_from(SPANS_MS))
        def happen(self, deed: str, span_ms: int) -> None:
            getattr(self.world, deed)()
            self.world.pass_ms(span_ms)

    return Histories


@pytest.mark.parametrize(
    "examples", [12, pytest.param(1000, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])]
)
def test_no_history_makes_host_and_node_forget(nodes: HostNodes, examples: int) -> None:
    run_state_machine_as_test(
        histories(nodes),
        settings=settings(
            max_examples=examples, stateful_step_count=30, deadline=None, report_multiple_bugs=False
        ),
    )


DEEDS: dict[str, Callable[[World], object]] = {
    "stopped for 1 ms": lambda world: world.fail("emergency_stop", 1),
    "stopped": lambda world: world.fail("emergency_stop", 130),
    "encoder": lambda world: world.fail("encoder", 30),
    "overload": lambda world: world.fail("overload", 30),
    "Hall link dies": lambda world: setattr(world.broken, "hall", True),
    "torque link dies": lambda world: setattr(world.broken, "torque_node", True),
    "drive link dies": lambda world: setattr(world.broken, "drive_link", True),
    "command link dies": lambda world: setattr(world.broken, "command_link", True),
    "mended": lambda world: setattr(world, "broken", Broken()),
    "clear": lambda world: world.order("clear"),
    "jog": lambda world: world.order("jog"),
}


def walk(nodes: HostNodes, deeds: tuple[str, ...], span_ms: int) -> None:
    """These deeds, so long apart, then a rig that is mended and left alone until every clear has ended."""
    world = awake(nodes)
    for deed in deeds:
        DEEDS[deed](world)
        world.pass_ms(span_ms)
    world.broken = Broken()
    world.pass_ms(300)


def short_histories(length: int) -> Iterator[tuple[str, ...]]:
    """Every sequence of deeds in which none follows itself."""
    for deeds in product(DEEDS, repeat=length):
        if all(a != b for a, b in pairwise(deeds)):
            yield deeds


@pytest.mark.whole
@pytest.mark.parametrize(
    ("length", "span_ms"),
    [
        (2, 40),
        (2, 130),
        *(
            pytest.param(length, span_ms, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])
            for length in (3, 4)
            for span_ms in (7, 40, 130)
        ),
    ],
)
def test_no_short_history_makes_host_and_node_forget(nodes: HostNodes, length: int, span_ms: int) -> None:
    for deeds in short_histories(length):
        try:
            walk(nodes, deeds, span_ms)
        except AssertionError as broken:
            pytest.fail(f"{' - '.join(deeds)}, {span_ms} ms apart: {broken}")


# what each broken rig forgets, in the fewest deeds: the model would have found it


def stopped_while_a_link_is_dead(world: World) -> None:
    world.order("jog")
    world.pass_ms(300)
    world.fail("torque_node", 130)
    world.fail("emergency_stop", 2)  # between two looks of the host
    world.pass_ms(298)
    world.order("jog")
    world.pass_ms(300)


def stopped_again_while_it_is_cleared(world: World) -> None:
    world.fail("emergency_stop", 300)
    world.pass_ms(20)
    world.order("clear")
    world.pass_ms(40)
    world.fail("emergency_stop", 1)
    world.pass_ms(1500)


def stopped_again_while_no_clear_arrives(world: World) -> None:
    world.fail("emergency_stop", 300)
    world.pass_ms(150)
    world.broken.command_link = True
    world.order("clear")
    world.pass_ms(200)
    world.fail("emergency_stop", 1)
    world.pass_ms(200)
    world.broken.command_link = False
    world.pass_ms(1500)


def another_link_dies_while_it_is_cleared(world: World) -> None:
    world.fail("emergency_stop", 300)
    world.pass_ms(150)
    world.broken.drive_link = True
    world.pass_ms(1)
    world.order("clear")
    world.pass_ms(300)
    world.broken.drive_link = False
    world.pass_ms(1500)


def two_faults_of_one_name(world: World) -> None:
    world.order("jog")
    world.pass_ms(300)
    world.fail("heartbeat", 130)
    world.fail("encoder", 30)
    world.pass_ms(30)


def a_link_that_comes_back(world: World) -> None:
    world.pass_ms(2000)
    world.fail("hall", 200)
    world.pass_ms(300)


def overloaded_while_it_rests(world: World) -> None:
    world.fail("overload", 20)
    world.pass_ms(300)


FORGETFUL_GUARDS = {
    "adds nothing to a fault": (
        "guard->faults |= latching;",
        ";",
        stopped_while_a_link_is_dead,
        "1: the supply|1: a",
    ),
    "looks at no sight": (
        "now_us - guard->sight_us + guard->config.latch_us",
        "guard->config.latch_us",
        stopped_again_while_no_clear_arrives,
        "1: a clear ended what came after it",
    ),
    "keeps its supply": (
        "guard->state == NR_READY || guard->state == NR_RUNNING;",
        "guard->state != NR_SILENT;",
        stopped_again_while_it_is_cleared,
        "1: the supply is on in spite of",
    ),
    "wakes by itself": (
        "if (guard->clear_asked) {",
        "if (guard->state == NR_SILENT || guard->clear_asked) {",
        overloaded_while_it_rests,
        "2: the supply closes",
    ),
}


@pytest.mark.parametrize("name", [None, *FORGETFUL_GUARDS])
def test_the_model_notices_a_guard_that_forgets(tmp_path: Path, built: Path, name: str | None) -> None:
    if name is None:
        for _, _, history, _ in FORGETFUL_GUARDS.values():
            history(awake(HostNodes(built)))
        return
    old, new, history, told = FORGETFUL_GUARDS[name]
    firmware = firmware_folder()
    text = (firmware / "core/nr_guard.c").read_text()
    assert text.count(old) == 1
    changed = tmp_path / "nr_guard.c"
    changed.write_text(text.replace(old, new))
    others = [path for path in (firmware / "core").glob("*.c") if path.name != changed.name]
    subprocess.run(
        [sys.executable, "-m", "ziglang", "cc", "-std=c11", "-O1", "-fPIC", "-shared", "-w",
         "-I", firmware / "core", changed, *others, firmware / "generated/needle_rig.c",
         "-o", tmp_path / "libneedle_rig_nodes.so"],
        check=True,
    )  # fmt: skip
    with pytest.raises(AssertionError, match=told):
        history(awake(HostNodes(tmp_path)))


def _clears_by_itself(patch: pytest.MonkeyPatch) -> None:
    def command(_self: object, measurement: object) -> Command | None:
        return None if clearing.awake(measurement) else Command(clear=True)  # type: ignore[arg-type]

    patch.setattr(clearing.ClearHandshake, "command", command)


def _keeps_the_last_fault_alone(patch: pytest.MonkeyPatch) -> None:
    take = standing.StandingFaults.take

    def forget(self: standing.StandingFaults, found: object) -> None:
        self._latched.clear()
        take(self, found)  # type: ignore[arg-type]

    patch.setattr(standing.StandingFaults, "take", forget)


def _clears_through_faults(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(clearing.ClearHandshake, "cancel", lambda _self: None)


def _one_fault_a_name(patch: pytest.MonkeyPatch) -> None:
    own = limits._own
    patch.setattr(limits, "_own", lambda *told: dataclasses.replace(own(*told), bit=DriveFault.NONE))


def _supply_stays_on(patch: pytest.MonkeyPatch) -> None:
    act = Brain._act

    def never_silent(*told: object) -> Command:
        command = act(*told)  # type: ignore[arg-type]
        return Command() if command.release else command

    patch.setattr(Brain, "_act", never_silent)


FORGETFUL_HOSTS = {
    "clears by itself": (_clears_by_itself, a_link_that_comes_back, "2: the supply closes"),
    "keeps the last fault alone": (_keeps_the_last_fault_alone, overloaded_while_it_rests, "3: "),
    "clears through faults": (
        _clears_through_faults,
        another_link_dies_while_it_is_cleared,
        "2: the supply closes after a fault or a stop",
    ),
    "tells one fault a name": (_one_fault_a_name, two_faults_of_one_name, "4: the text does not name"),
    "lets the supply on": (
        _supply_stays_on,
        overloaded_while_it_rests,
        "1: a latched fault leaves the supply on",
    ),
}


@pytest.mark.parametrize("name", [None, *FORGETFUL_HOSTS])
def test_the_model_notices_a_host_that_forgets(
    nodes: HostNodes, monkeypatch: pytest.MonkeyPatch, name: str | None
) -> None:
    if name is None:
        for _, history, _ in FORGETFUL_HOSTS.values():
            history(awake(nodes))
        return
    broken, history, told = FORGETFUL_HOSTS[name]
    broken(monkeypatch)
    with pytest.raises(AssertionError, match=told):
        history(awake(nodes))
