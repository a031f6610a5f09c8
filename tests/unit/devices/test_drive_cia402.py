"""The CiA 402 drive: what it refuses, what it says, how old its position is."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable

import pytest

from needle_rig.config.schema import Cia402Drive
from needle_rig.devices.contract import Bench, Broken
from needle_rig.devices.drive_cia402 import DriveCia402, SyncAnswers
from needle_rig.records import STOP, Command, DriveFault, DriveState
from needle_rig.simulation.nodes.cia402_node import _Entry
from needle_rig.simulation.nodes.twins import DriveTwin

OPTIONS = Cia402Drive(device="cia402", node_id=5, position_units_per_turn=36_000, velocity_units_per_rpm=60)


def bench(change: Callable[[DriveTwin], None] = lambda twin: None) -> Bench:
    made = Bench(DriveCia402, OPTIONS, DriveTwin(OPTIONS))
    change(made.twin)  # type: ignore[arg-type]
    return made


def set_up(change: Callable[[DriveTwin], None] = lambda twin: None) -> Bench:
    made = bench(change)
    asyncio.run(made.set_up())
    made.run(0.1)
    return made


def drive_of(made: Bench) -> DriveCia402:
    assert isinstance(made.device, DriveCia402)
    return made.device


def without(index: int, subindex: int = 0) -> Callable[[DriveTwin], None]:
    def change(twin: DriveTwin) -> None:
        del twin._drive._objects[index, subindex]

    return change


def read_only(index: int, subindex: int) -> Callable[[DriveTwin], None]:
    def change(twin: DriveTwin) -> None:
        twin._drive._objects[index, subindex].writable = False

    return change


def deaf_consumer(twin: DriveTwin) -> None:
    """Takes a heartbeat time and keeps 0, as a drive whose firmware does not do it."""
    served = twin._drive._set

    def keep_zero(index: int, subindex: int, entry: _Entry, size_bytes: int, value: int) -> int:
        return 0 if index == 0x1016 else served(index, subindex, entry, size_bytes, value)

    twin._drive._set = keep_zero  # type: ignore[method-assign]


def no_drive(twin: DriveTwin) -> None:
    twin._drive._objects[0x1000, 0].value = 0x000F0191


def no_csv(twin: DriveTwin) -> None:
    twin._drive._objects[0x6502, 0].value = 1 << 2


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (read_only(0x1016, 1), r"object 0x1016:1 does not take 0x7f0032"),
        (without(0x6007), r"object 0x6007:0 does not take 0x3: .*does not exist"),
        (deaf_consumer, r"does not keep 0x7f0032 in object 0x1016:1: it would not stop for a lost host"),
        (no_drive, r"CANopen node 5 has the profile 401, not 402: it is no drive"),
        (no_csv, r"CANopen node 5 has no mode csv; see links\.drive\.mode"),
    ],
)
def test_a_drive_that_would_not_stop_by_itself_is_refused(
    change: Callable[[DriveTwin], None], told: str
) -> None:
    made = bench(change)
    with pytest.raises(Broken, match=told):
        asyncio.run(made.set_up())
    assert drive_of(made).needs_set_up(made.host.now_s)
    made.run(0.1, Command(1.0, enable=True))
    assert made.motor_rad_s == 0.0


def test_a_node_that_does_not_answer_is_named_with_its_bus() -> None:
    made = bench()
    made.twin.receive = lambda now_s, frame_id, data: None  # type: ignore[method-assign]
    with pytest.raises(Broken, match=r"CANopen node 5 \(memory\) does not answer .*look at its supply"):
        asyncio.run(made.set_up())


def emergency(code: int) -> bytes:
    return struct.pack("<HB5x", code, 1)


@pytest.mark.parametrize(
    ("code", "fault", "told"),
    [
        (0x8130, DriveFault.HEARTBEAT, "the host's heartbeat stayed away"),
        (0x8250, DriveFault.COMMAND_AGE, "no command in time"),
        (0x8120, DriveFault.FRAME, "CAN error passive"),
        (0x8611, DriveFault.STALL, "following error"),
        (0x7380, DriveFault.ENCODER, "additional modules"),
        (0x3210, DriveFault.NONE, "over-voltage of the supply"),
        (0xFF01, DriveFault.NONE, "the maker's own"),
    ],
)
def test_an_emergency_frame_becomes_a_bit_where_there_is_one_and_a_sentence_always(
    code: int, fault: DriveFault, told: str
) -> None:
    made = set_up()
    made.tick(Command(clear=True))
    made.host.bring(0x085, emergency(code))
    assert drive_of(made).faults == fault
    assert f"emergency 0x{code:04x} ({told})" in drive_of(made).complaint(0)


def test_a_host_that_pauses_before_it_wakes_the_drive_leaves_no_fault() -> None:
    made = set_up()
    for _ in range(200):
        made.step()
    made.run(0.1)
    assert drive_of(made).faults == DriveFault.NONE
    assert drive_of(made).complaint(0) == ""
    made.tick(Command(clear=True))
    made.run(0.05)
    assert drive_of(made).state is DriveState.READY


@pytest.mark.parametrize("data", [b"", b"\x01", bytes(7), bytes(9)])
def test_an_emergency_frame_of_another_length_is_none(data: bytes) -> None:
    made = set_up()
    made.host.bring(0x085, data)
    assert drive_of(made).complaint(0) == ""


def test_a_warning_that_passes_is_forgotten_while_the_drive_goes_on() -> None:
    made = set_up()
    made.tick(Command(clear=True))
    made.run(0.05)
    assert drive_of(made).state is DriveState.READY
    made.host.bring(0x085, emergency(0x8120))
    made.run(0.05)
    assert drive_of(made).faults == DriveFault.FRAME
    made.host.bring(0x085, emergency(0))
    made.run(0.02)
    assert drive_of(made).faults == DriveFault.NONE


def test_a_fault_whose_emergency_was_missed_tells_its_error_code() -> None:
    made = set_up()
    twin = made.twin
    assert isinstance(twin, DriveTwin)
    twin._drive.fail(0x7305)
    twin._drive._outbox.clear()
    made.run(0.05)
    assert drive_of(made).state is DriveState.FAULT
    assert drive_of(made).faults == DriveFault.ENCODER
    assert drive_of(made).complaint(0) == "error 0x7305 (encoder 1)"


@pytest.mark.parametrize("frame_id", [0x000, 0x080, 0x205, 0x605, 0x77F])
def test_commands_of_another_master_are_counted(frame_id: int) -> None:
    made = set_up()
    made.host.bring(frame_id, b"\x01")
    assert drive_of(made).foreign_commands == 1


def test_frames_of_others_are_no_commands() -> None:
    made = set_up()
    for frame_id in (0x101, 0x206, 0x185, 0x585, 0x705, 0x706):
        made.host.bring(frame_id, b"\x05")
    assert drive_of(made).foreign_commands == 0


def test_the_heartbeat_comes_from_the_tick_alone() -> None:
    made = set_up()
    made.host.sent.clear()
    made.host.now_s += 1.0
    assert not made.host.sent
    drive_of(made).command(STOP)
    assert [frame_id for frame_id, _ in made.host.sent] == [0x205, 0x77F, 0x080]


def test_a_position_is_as_old_as_the_sync_that_it_answers() -> None:
    made = set_up()
    late: list[tuple[int, bytes]] = []
    step = made.twin.step

    def delayed(now_s: float) -> list[tuple[int, bytes]]:
        late.extend(step(now_s))
        return [late.pop(0)] if len(late) > 2 else []

    made.twin.step = delayed  # type: ignore[method-assign]
    made.run(0.1)
    assert 0.010 < made.age_s() < 0.030


def test_answers_that_are_lost_do_not_make_later_ones_old() -> None:
    made = set_up()
    oldest_s = 0.0
    for _ in range(20):  # a tenth is lost
        made.fault = "silence"
        made.tick(STOP)
        made.fault = ""
        for _ in range(9):
            made.tick(STOP)
            oldest_s = max(oldest_s, made.age_s())
    assert oldest_s < 0.045


def test_syncs_wait_for_answers_that_are_late_and_go_on_when_they_are_lost() -> None:
    answers = SyncAnswers(0.005)
    assert [answers.ask(n * 0.005) for n in range(4)] == [True] * 4
    assert not answers.ask(0.020)
    assert answers.answered(0.021) == 0.0
    assert answers.ask(0.022)
    assert not answers.ask(0.025)
    assert not answers.ask(0.033)
    assert answers.ask(0.0345), "they came steadily and stopped with the SYNCs: lost"
    assert answers.answered(0.035) == 0.0345
    assert answers.answered(0.036) is None


def test_answers_that_stopped_before_the_syncs_may_be_on_a_longer_way() -> None:
    answers = SyncAnswers(0.005)
    for n in range(4):
        assert answers.ask(n * 0.005)
        assert answers.answered(n * 0.005 + 0.001) == n * 0.005
    asked = [0.020, 0.025, 0.030, 0.035]
    assert all(answers.ask(at_s) for at_s in asked)
    assert not any(answers.ask(at_s) for at_s in (0.040, 0.050, 0.060))
    assert [answers.answered(at_s + 0.04) for at_s in asked] == asked, "each is 40 ms old, and says so"
    assert answers.ask(0.080)
    for at_s in (0.085, 0.090, 0.095):
        answers.ask(at_s)
    assert not answers.ask(0.144)
    assert answers.ask(0.1451), "nothing came for 50 ms: lost"


def test_a_status_that_nobody_asked_for_is_no_reading() -> None:
    made = set_up()
    made.fault = "silence"
    made.tick(STOP)
    before_s = drive_of(made)._sampled_s
    drive_of(made)._answers = SyncAnswers(0.005)
    made.host.bring(0x185, struct.pack("<HiH", 0x0270, 0, 0))
    assert drive_of(made)._sampled_s == before_s


def test_positions_are_followed_over_the_end_of_their_range() -> None:
    made = set_up()
    drive, host = drive_of(made), made.host
    made.fault = "silence"
    drive._units = 2**31 - 1800
    drive._zero_rad = drive._units * drive._unit_rad
    for place in (2**31 - 900, -(2**31) + 0, -(2**31) + 900):
        drive.command(STOP)
        host.now_s += 0.005
        host.bring(0x185, struct.pack("<HiH", 0x0250, place, 0))
    assert drive.angle_rad == pytest.approx(2700 * drive._unit_rad, abs=1e-6)


def test_a_drive_that_starts_again_in_its_set_up_is_set_up_anew() -> None:
    made = bench()
    written = made.twin.receive

    def restarts(now_s: float, frame_id: int, data: bytes) -> None:
        written(now_s, frame_id, data)
        if frame_id == 0x605 and data[1:3] == b"\xff\x60":
            made.host.bring(0x705, b"\x00")

    made.twin.receive = restarts  # type: ignore[method-assign]
    with pytest.raises(Broken, match="started again while it was set up"):
        asyncio.run(made.set_up())
