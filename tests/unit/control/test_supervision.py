"""What is watched from switch-on to switch-off, and what a link that is dead takes away from it."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.control.faults import Fault, FaultName
from needle_rig.control.in_si import supervision_of
from needle_rig.control.limits import LINKS
from needle_rig.control.supervision import Supervision
from needle_rig.records import STOP, Command, DriveState, Measurement
from needle_rig.units import rad

CONFIG = load_rig_config(None)
TICK_S = 0.005
GOOD = Measurement(
    0.0, 0.0, 0.0, (0.0,) * 4, DriveState.READY, torque_age_s=0.0, hall_age_s=0.0, drive_age_s=0.0
)
TURNING = Command(rad(20.0), enable=True)


class Watched:
    """A supervision, its time, and the newest reading."""

    def __init__(self) -> None:
        self.supervision: Supervision = supervision_of(CONFIG)
        self.now = GOOD

    def tick(
        self,
        command: Command = STOP,
        *,
        dead: str = "",
        unseen_s: float = 0.0,
        in_time: bool = True,
        **changes: Any,
    ) -> list[FaultName]:
        return [fault.name for fault in self.faults(command, dead, unseen_s, in_time, **changes)]

    def faults(
        self,
        command: Command = STOP,
        dead: str = "",
        unseen_s: float = 0.0,
        in_time: bool = True,
        **changes: Any,
    ) -> list[Fault]:
        self.now = dataclasses.replace(self.now, time_s=self.now.time_s + TICK_S, **changes)
        heard = LINKS - {dead}
        step = self.supervision.step(self.now, heard, command, TICK_S, unseen_s=unseen_s, in_time=in_time)
        return list(step)

    def turned(self, by_deg: float) -> dict[str, Any]:
        """The base with all of its needle, turned further."""
        angle_rad = self.now.base_angle_rad + rad(by_deg)
        return {"base_angle_rad": angle_rad, "hall_rad": (angle_rad,) * 4}


@pytest.mark.parametrize(
    ("command", "unseen_s", "blind"),
    [
        (TURNING, 0.1, False),
        (TURNING, math.nextafter(0.1, 1.0), True),
        (STOP, 10.0, False),
        (STOP, 0.0, False),
    ],
)
def test_an_enabled_drive_that_is_not_heard_is_a_fault_that_passes(
    command: Command, unseen_s: float, blind: bool
) -> None:
    found = Watched().faults(command, "drive", unseen_s)
    assert [(fault.name, fault.latching) for fault in found] == [(FaultName.BLIND, False)] * blind


def test_it_says_for_how_long_the_drive_was_not_heard() -> None:
    (fault,) = Watched().faults(TURNING, "drive", 12.345)
    assert fault.text == (
        "the drive is enabled and was not heard for 12345 ms, limit 100 ms: nobody sees what the base does;"
        " check its link"
    )


def test_another_master_latches_until_a_person_forgives_what_he_saw() -> None:
    watched = Watched()
    assert watched.tick() == []
    (fault,) = watched.faults(foreign_commands=1)
    assert (fault.name, fault.latching) == (FaultName.SECOND_MASTER, True)
    assert fault.text.startswith("another master sent 1 commands to the drive; take it off the bus, then")
    watched.supervision.clear(watched.now)
    assert watched.tick() == []
    (fault,) = watched.faults(foreign_commands=4, dead="drive")
    assert "sent 3 commands" in fault.text
    watched.supervision.clear(None)
    assert watched.tick() == [FaultName.SECOND_MASTER]


@pytest.mark.parametrize("dead", ["", "torque", "hall", "drive"])
@pytest.mark.parametrize("in_time", [True, False])
def test_a_dead_link_hides_no_motion_that_the_encoder_tells(dead: str, in_time: bool) -> None:
    watched = Watched()
    watched.tick()
    found: list[FaultName] = []
    for _ in range(40):
        found += watched.tick(dead=dead, in_time=in_time, **watched.turned(0.2))
    assert (FaultName.IDLE_MOTION in found) == (dead != "drive")


def test_a_drive_that_was_not_heard_is_judged_by_what_was_asked_meanwhile() -> None:
    followed, stood = Watched(), Watched()
    for watched in (followed, stood):
        watched.tick()
        for _ in range(100):
            assert watched.tick(TURNING, dead="drive") == []
    assert followed.tick(TURNING, **followed.turned(20.0 * 101 * TICK_S)) == []
    assert stood.tick(TURNING) == [FaultName.NOT_TURNING]


@pytest.mark.parametrize("state", list(DriveState))
def test_a_hand_may_turn_a_base_that_has_no_supply(state: DriveState) -> None:
    watched = Watched()
    watched.tick(drive_state=state)
    found: list[FaultName] = []
    for _ in range(40):
        found += watched.tick(**watched.turned(0.2))
    by_hand = state in (DriveState.SILENT, DriveState.FAULT)
    assert (FaultName.IDLE_MOTION not in found) == by_hand
    assert (watched.tick(drive_state=DriveState.READY) == []) == by_hand


def test_a_command_without_enable_asks_for_no_turn() -> None:
    watched = Watched()
    for _ in range(100):
        assert watched.tick(Command(rad(20.0))) == []


@pytest.mark.parametrize(
    ("dead", "in_time", "seen"), [("", True, True), ("", False, False), ("hall", True, False)]
)
def test_witnesses_are_compared_where_all_are_heard_at_one_time(dead: str, in_time: bool, seen: bool) -> None:
    watched = Watched()
    watched.tick()
    found: list[FaultName] = []
    for _ in range(40):
        hall_rad = (watched.now.hall_rad[0] + rad(1.0),) * 4
        found += watched.tick(dead=dead, in_time=in_time, hall_rad=hall_rad)
    assert (FaultName.ENCODER_DISAGREES in found) == seen
    if seen:
        watched.supervision.clear(watched.now)
        assert watched.tick() == [FaultName.ENCODER_DISAGREES], "a reference alone settles it"


def test_a_lost_zero_latches_and_hides_the_shaft_until_the_drive_has_one() -> None:
    watched = Watched()
    watched.tick()
    for _ in range(5):
        (fault,) = watched.faults(referenced=False, **watched.turned(20.0))
        assert (fault.name, fault.latching) == (FaultName.REFERENCE_LOST, True)
    watched.supervision.reference.tell(0.0)
    for _ in range(5):
        assert watched.tick(**watched.turned(20.0)) == [], "it is being told"
    watched.now = dataclasses.replace(watched.now, referenced=True, base_angle_rad=0.0)
    assert watched.tick() == []
    for _ in range(40):
        assert watched.tick() == [], "compared from the new zero on, wherever the needle stood before"


@pytest.mark.parametrize(("dead", "told"), [("", True), ("hall", False), ("torque", False)])
def test_a_first_look_confirms_the_zero_by_what_all_links_say(dead: str, told: bool) -> None:
    watched = Watched()
    assert watched.tick(dead=dead, referenced=False) == []
    assert (watched.supervision.reference.wanted_rad is not None) == told


@pytest.mark.parametrize("dead_ticks", [0, 1, 20])
@pytest.mark.parametrize("spoilt", ["encoder", "Hall angles"])
def test_the_first_answer_after_a_reference_is_held_against_the_reading_it_belongs_to(
    spoilt: str, dead_ticks: int
) -> None:
    """The drive takes its zero, falls silent, and what counts from another zero is heard next."""
    watched = Watched()
    wanted_rad = []
    for referenced, in_time in ((False, True), (False, True), (True, False)):
        assert watched.tick(referenced=referenced, in_time=in_time) == []
        wanted_rad.append(watched.supervision.reference.wanted_rad)
    assert wanted_rad == [0.0, 0.0, None]
    for _ in range(dead_ticks):
        assert watched.tick(dead="drive") == []
    # 20 ms of smoothing, and nobody could see the 90° as a jump of the drive's own angle
    watched.now = dataclasses.replace(watched.now, time_s=watched.now.time_s + 1.0)
    lie = {"base_angle_rad": rad(90.0)} if spoilt == "encoder" else {"hall_rad": (rad(90.0),) * 4}
    found = [fault for _ in range(5) for fault in watched.faults(**lie)]
    assert {FaultName.TWIST_WITHOUT_TORQUE, FaultName.ENCODER_DISAGREES} & {fault.name for fault in found}


def test_a_person_s_word_is_the_datum_where_no_hall_angle_was_heard() -> None:
    """Then the next reading of all is, as nothing belongs to the word, and the datum before it is gone."""
    watched = Watched()
    assert [watched.tick() for _ in range(5)] == [[]] * 5
    watched.supervision.reference.tell(rad(45.0))
    assert watched.tick(dead="hall", base_angle_rad=0.0, referenced=False) == []
    assert watched.tick(dead="hall", base_angle_rad=rad(45.0), referenced=True) == []
    assert [watched.tick() for _ in range(40)] == [[]] * 40
    found = [name for _ in range(5) for name in watched.tick(base_angle_rad=rad(65.0))]
    assert FaultName.TWIST_WITHOUT_TORQUE in found


def test_a_link_that_dies_while_the_drive_is_told_leaves_the_datum_before() -> None:
    watched = Watched()
    told = [
        watched.tick(referenced=False),
        watched.tick(dead="torque"),
        watched.tick(dead="torque"),
        watched.tick(referenced=True, in_time=False),
    ]
    assert told == [[]] * 4
    watched.now = dataclasses.replace(watched.now, time_s=watched.now.time_s + 1.0)
    found = [name for _ in range(5) for name in watched.tick(base_angle_rad=rad(90.0))]
    assert {FaultName.TWIST_WITHOUT_TORQUE, FaultName.ENCODER_DISAGREES} & set(found)


def test_a_reading_of_a_late_computer_is_no_datum() -> None:
    """Its values are of different age: Hall angles here of a shaft that has turned since."""
    watched = Watched()
    assert watched.tick(referenced=False) == []
    watched.supervision.reference.tell(0.0)
    assert watched.tick(in_time=False, hall_rad=(rad(50.0),) * 4) == []
    assert watched.tick(referenced=True, hall_rad=(0.0,) * 4) == []
    assert [watched.tick() for _ in range(40)] == [[]] * 40


def test_a_search_for_the_index_is_watched_from_its_first_reading() -> None:
    watched = Watched()
    watched.tick()
    assert watched.tick(referenced=False) == [FaultName.REFERENCE_LOST]
    watched.supervision.reference.searching = True
    for _ in range(20):
        assert watched.tick(TURNING, **watched.turned(0.1)) == []
