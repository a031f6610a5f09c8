"""The zero of the drive: confirmed at the first look, lost by a reset, found again in three ways."""

from __future__ import annotations

import dataclasses
import math

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.faults import FaultName
from needle_rig.control.reference import TELLING_S
from needle_rig.control.reports import Request
from needle_rig.errors import BadInput, RigFault
from needle_rig.records import STOP, Command, DriveFault, DriveState, Measurement, Phase, Sample
from needle_rig.units import deg, rad
from tests.values import now

CONFIG = load_rig_config(None)
TICK_S = 0.005


class Node:
    """A drive node that counts from where it was switched on, and a needle that turns with its base."""

    def __init__(self, brain: Brain | None = None, true_deg: float = 0.0, encoder_deg: float = 0.0) -> None:
        self.brain = brain or Brain(CONFIG)
        self.true_rad, self.encoder_rad = rad(true_deg), rad(encoder_deg)
        self.referenced, self.deaf = False, False
        self.state = DriveState.READY
        self.index_at_rad: float | None = None
        self.index_rad = math.nan
        self.time_s = 0.0
        self.command = STOP
        self.hall_rad: tuple[float, ...] | None = None
        self.changes: dict[str, object] = {}

    def read(self) -> Measurement:
        halls = self.hall_rad or (self.true_rad,) * 4
        measured = Measurement(
            self.time_s,
            self.encoder_rad,
            0.0,
            halls,
            self.state,
            torque_age_s=0.001,
            hall_age_s=0.001,
            drive_age_s=0.001,
            referenced=self.referenced,
            index_rad=self.index_rad,
        )
        return dataclasses.replace(measured, **self.changes)  # type: ignore[arg-type]

    def tick(self) -> Sample:
        self.time_s += TICK_S
        if self.command.enable:
            turned = self.command.velocity_rad_s * TICK_S
            if self.index_at_rad is not None:
                passed = (self.true_rad - self.index_at_rad) * (self.true_rad + turned - self.index_at_rad)
                if passed <= 0.0:
                    self.index_rad = self.encoder_rad + self.index_at_rad - self.true_rad
            self.true_rad += turned
            self.encoder_rad += turned
        if self.command.reference_rad is not None and not self.deaf:
            self.encoder_rad, self.referenced = self.command.reference_rad, True
        self.command, sample = self.brain.step(self.read(), TICK_S)
        return sample

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.tick()

    def reset(self) -> None:
        self.encoder_rad, self.referenced, self.index_rad = 0.0, False, math.nan

    @property
    def fault(self) -> str | None:
        return self.brain.state.fault_name


@pytest.mark.parametrize(("true_deg", "confirmed"), [(0.0, True), (4.9, True), (-4.9, True), (5.1, False)])
def test_at_the_first_look_the_hall_angles_confirm_the_zero_or_do_not(
    true_deg: float, confirmed: bool
) -> None:
    node = Node(true_deg=true_deg)
    node.ticks(3)
    assert node.referenced == confirmed
    assert node.fault == (None if confirmed else FaultName.REFERENCE_LOST)
    if confirmed:
        assert node.encoder_rad == 0.0, "the encoder's own zero is the finer one"
    else:
        assert "its encoder says 0.0°, the Hall angles 5.1°" in (node.brain.state.fault or "")
        assert "needle-rig home" in (node.brain.state.fault or "")


def known_at_45() -> Node:
    node = Node()
    node.brain.compensate(Request(rad(45.0), "none", settle_s=0.2))
    while node.brain.state.phase is not Phase.DONE:
        node.tick()
    assert deg(node.true_rad) == pytest.approx(45.0, abs=0.1)
    return node


def test_a_reset_while_idle_is_noticed_latches_and_lets_nothing_start() -> None:
    node = known_at_45()
    node.reset()
    node.tick()
    assert node.fault == FaultName.REFERENCE_LOST
    for _ in range(3):
        with pytest.raises(RigFault, match="find it again: needle-rig home"):
            node.brain.compensate(Request(rad(45.0), "none"))
        with pytest.raises(RigFault, match="find it again"):
            node.brain.jog(by_rad=0.1)
        node.brain.clear()
        node.ticks(3)
        assert node.fault == FaultName.REFERENCE_LOST, "a clear does not find a zero"
    assert deg(node.true_rad) == pytest.approx(45.0, abs=0.1)


def test_a_reset_is_noticed_though_the_hall_angles_agree() -> None:
    node = Node()
    node.ticks(5)
    assert node.referenced
    node.reset()
    node.tick()
    assert node.fault == FaultName.REFERENCE_LOST


@pytest.mark.parametrize("instant", range(1, 400, 13))
def test_a_reset_in_motion_stops_the_drive_in_the_same_tick(instant: int) -> None:
    node = Node()
    node.brain.compensate(Request(rad(45.0), "none", settle_s=0.2))
    node.ticks(instant)
    node.reset()
    node.tick()
    if instant == 1:
        return  # its zero had not been confirmed yet: it is, at 0
    assert node.command.velocity_rad_s == 0.0
    assert not node.command.enable
    assert node.fault == FaultName.REFERENCE_LOST


def test_it_is_found_again_by_the_hall_angles() -> None:
    node = known_at_45()
    node.reset()
    node.ticks(2)
    node.brain.home("hall")
    node.ticks(3)
    assert (node.referenced, node.fault, node.brain.state.phase) == (True, None, Phase.IDLE)
    assert deg(node.encoder_rad) == pytest.approx(45.0, abs=0.1)
    node.brain.compensate(Request(rad(30.0), "none", settle_s=0.2))
    while node.brain.state.phase is not Phase.DONE:
        node.tick()
    assert deg(node.true_rad) == pytest.approx(30.0, abs=0.2)


def test_a_person_may_say_where_it_stands() -> None:
    node = known_at_45()
    node.reset()
    node.ticks(2)
    with pytest.raises(BadInput, match="outside ±720°"):
        node.brain.home("here", rad(721.0))
    node.brain.home("here", rad(45.0))
    node.ticks(3)
    assert now(node.fault) is None
    assert deg(node.encoder_rad) == pytest.approx(45.0)


@pytest.mark.parametrize("index_deg", [10.0, 100.0, -60.0])
def test_it_is_found_by_the_index_mark_in_a_slow_turn(index_deg: float) -> None:
    node = Node(Brain(load_rig_config(None, {"drive.index_deg": index_deg})))
    node.brain.compensate(Request(rad(45.0), "none", settle_s=0.2))
    while now(node.brain.state.phase) is not Phase.DONE:
        node.tick()
    node.reset()
    node.index_at_rad = rad(index_deg) if index_deg < 45 else rad(index_deg - 360.0)
    node.ticks(2)
    node.brain.home("index")
    fastest = 0.0
    for _ in range(20_000):
        node.tick()
        fastest = max(fastest, abs(node.command.velocity_rad_s))
        if node.brain.state.phase is Phase.DONE and node.referenced:
            break
    node.ticks(3)
    assert 0.0 < deg(fastest) <= 10.1
    assert node.fault is None
    assert deg(node.encoder_rad) == pytest.approx(deg(node.true_rad), abs=0.2)


def test_a_mark_that_passed_since_the_node_started_needs_no_search() -> None:
    node = known_at_45()
    node.reset()
    node.index_rad = rad(-45.0)  # it passed 45° before where the node was switched on
    node.ticks(2)
    node.brain.home("index")
    node.ticks(3)
    assert now(node.fault) is None
    assert deg(node.encoder_rad) == pytest.approx(45.0, abs=0.1)


def test_a_drive_that_does_not_listen_is_told_for_a_second() -> None:
    node = Node()
    node.deaf = True
    node.ticks(2)
    assert node.command == Command(reference_rad=0.0)
    node.ticks(round(TELLING_S / TICK_S) + 2)
    assert node.fault == FaultName.REFERENCE_LOST
    assert "does not take the angle" in (node.brain.state.fault or "")


def test_nothing_moves_before_the_zero_is_known() -> None:
    node = Node()
    node.deaf = True
    node.brain.compensate(Request(rad(45.0), "none"))
    for _ in range(400):
        node.tick()
        assert not node.command.enable


def test_a_person_s_word_also_serves_hall_sensors_that_lost_their_turns() -> None:
    node = known_at_45()
    node.changes = {"hall_age_s": 1.0, "hall_complaint": "its turns are not known"}
    node.ticks(60)
    assert node.fault == FaultName.LINK_DEAD
    with pytest.raises(RigFault, match="its turns are not known"):
        node.brain.home("hall")
    node.brain.home("here", rad(45.0))
    node.tick()
    assert node.command.reference_rad == pytest.approx(rad(45.0))
    node.changes = {}
    node.ticks(3)
    assert node.fault is None


@pytest.mark.parametrize(("jump_deg", "lost"), [(-34.0, False), (34.0, False), (-36.0, True), (90.0, True)])
def test_a_drive_that_does_not_tell_of_its_start_shows_it_by_its_angle(jump_deg: float, lost: bool) -> None:
    node = known_at_45()
    node.state = DriveState.SILENT
    node.ticks(2)
    node.encoder_rad += rad(jump_deg)
    node.tick()
    assert node.fault == (FaultName.REFERENCE_LOST if lost else None)
    if lost:
        assert "counts from another zero" in (node.brain.state.fault or "")
        node.brain.clear()
        node.ticks(5)
        assert node.fault == FaultName.REFERENCE_LOST
        node.brain.home("hall")
        node.ticks(3)
        assert now(node.fault) is None
        assert deg(node.encoder_rad) == pytest.approx(45.0, abs=0.1)


def test_a_zero_is_found_beside_a_fault_of_the_drive_which_stays() -> None:
    node = known_at_45()
    node.reset()
    node.changes = {"drive_state": DriveState.FAULT, "drive_faults": DriveFault.HEARTBEAT | DriveFault.STALL}
    node.ticks(2)
    assert node.fault == FaultName.REFERENCE_LOST
    with pytest.raises(RigFault, match="needle-rig clear"):
        node.brain.home("index")
    node.brain.home("hall")
    node.ticks(5)
    assert node.fault == FaultName.DRIVE
    assert not node.command.enable
    with pytest.raises(RigFault, match="needle-rig clear"):
        node.brain.jog(by_rad=0.1)
    node.changes = {}
    node.brain.clear()
    node.ticks(10)
    assert now(node.fault) is None
    node.brain.jog(by_rad=0.1)


@pytest.mark.parametrize("ends", ["without a mark", "by a fault", "by a stop"])
def test_a_search_that_finds_nothing_leaves_the_zero_lost(ends: str) -> None:
    node = known_at_45()
    node.reset()
    node.ticks(2)
    node.brain.home("index")
    node.ticks(200)
    assert node.command.enable
    if ends == "by a fault":
        node.changes = {"torque_nm": 1.0}
        node.tick()
        assert node.fault == FaultName.TORQUE_LIMIT
        node.changes = {}
        node.brain.clear()
    elif ends == "by a stop":
        node.brain.stop("a person")
    while node.brain.state.phase not in (Phase.FAULT, Phase.DONE):
        node.tick()
    node.ticks(3)
    assert node.fault == FaultName.REFERENCE_LOST
    with pytest.raises(RigFault, match="find it again"):
        node.brain.compensate(Request(rad(45.0), "none"))
