"""The simulated CiA 402 drive against the text of the standards, frame by frame."""

from __future__ import annotations

import struct

import pytest

from needle_rig.config.schema import Cia402Drive
from needle_rig.simulation.nodes.cia402_node import Cia402Node
from needle_rig.simulation.nodes.slcan_hub import Frame

OPTIONS = Cia402Drive(device="cia402", node_id=3, position_units_per_turn=3600, velocity_units_per_rpm=60)


class Bus:
    """The node alone, stepped by the millisecond; `encoder` is in thousandths of a degree."""

    def __init__(self) -> None:
        self.node, self.now_us, self.encoder, self.velocity_rad_s = Cia402Node(OPTIONS), 0, 0, 0.0
        self.boot = self.step()

    def step(self, times: int = 1) -> list[Frame]:
        frames: list[Frame] = []
        for _ in range(times):
            self.now_us += 1000
            sent, self.velocity_rad_s = self.node.step(self.now_us, self.encoder)
            frames += sent
        return frames

    def send(self, frame_id: int, text: str) -> list[Frame]:
        self.node.receive(self.now_us, frame_id, bytes.fromhex(text))
        return self.step()

    def sdo(self, text: str) -> str:
        answers = [data.hex(" ") for frame_id, data in self.send(0x603, text) if frame_id == 0x583]
        assert len(answers) == 1
        return answers[0]

    def control(self, word: int) -> int:
        """Write the controlword, let it act, and give the statusword's state bits."""
        self.sdo(f"2b 40 60 00 {word & 0xFF:02x} {word >> 8:02x} 00 00")
        self.step()
        return self.status() & 0x6F

    def status(self) -> int:
        return int(struct.unpack("<H", bytes.fromhex(self.sdo("40 41 60 00 00 00 00 00"))[4:6])[0])


@pytest.fixture
def bus() -> Bus:
    return Bus()


def test_it_says_once_that_it_started(bus: Bus) -> None:
    assert bus.boot == [(0x703, b"\x00")]
    assert bus.step(20) == []
    assert bus.send(0x000, "81 03") == [(0x703, b"\x00")]


@pytest.mark.parametrize(
    ("request_bytes", "answer"),
    [
        ("40 00 10 00 00 00 00 00", "43 00 10 00 92 01 02 00"),  # device type: 402, servo drive
        ("40 41 60 00 00 00 00 00", "4b 41 60 00 50 00 00 00"),  # switch on disabled, voltage
        ("2f 60 60 00 09 00 00 00", "60 60 60 00 00 00 00 00"),
        ("23 16 10 01 32 00 7f 00", "60 16 10 01 00 00 00 00"),
        ("40 99 99 00 00 00 00 00", "80 99 99 00 00 00 02 06"),  # there is no such object
        ("40 16 10 09 00 00 00 00", "80 16 10 09 11 00 09 06"),  # nor such a subindex
        ("2b 41 60 00 00 00 00 00", "80 41 60 00 02 00 01 06"),  # read only
        ("2f 40 60 00 06 00 00 00", "80 40 60 00 10 00 07 06"),  # wrong length
        ("2f 60 60 00 08 00 00 00", "80 60 60 00 30 00 09 06"),  # no such mode
        ("2f 00 16 00 00 00 00 00", "80 00 16 00 22 00 00 08"),  # the PDO is on
    ],
)
def test_sdo_answers_are_the_standards_bytes(bus: Bus, request_bytes: str, answer: str) -> None:
    assert bus.sdo(request_bytes) == answer


def test_a_node_that_is_stopped_answers_no_sdo(bus: Bus) -> None:
    bus.send(0x000, "02 03")
    assert bus.send(0x603, "40 00 10 00 00 00 00 00") == []


@pytest.mark.parametrize(
    ("words", "state"),
    [
        ((0x06,), 0x21),  # shutdown: ready to switch on
        ((0x0F,), 0x40),  # from switch on disabled nothing else helps
        ((0x06, 0x07), 0x23),  # switched on
        ((0x06, 0x07, 0x0F), 0x27),  # operation enabled
        ((0x06, 0x07, 0x0F, 0x07), 0x23),  # disable operation
        ((0x06, 0x07, 0x0F, 0x06), 0x21),  # shutdown
        ((0x06, 0x07, 0x0F, 0x00), 0x40),  # disable voltage
        ((0x06, 0x07, 0x00), 0x40),
        ((0x06, 0x07, 0x02), 0x40),  # quick stop of what does not turn
    ],
)
def test_the_state_machine_is_that_of_cia_402(bus: Bus, words: tuple[int, ...], state: int) -> None:
    found = 0
    for word in words:
        found = bus.control(word)
    assert found & (0x4F if state == 0x40 else 0x6F) == state


def test_a_fault_is_left_by_a_rising_edge_of_bit_7_alone(bus: Bus) -> None:
    bus.control(0x80)
    bus.node.fail(0x2310)
    assert (0x083, bytes.fromhex("10 23 01 00 00 00 00 00")) in bus.step()
    assert bus.control(0x80) & 0x4F == 0x08
    assert bus.control(0x00) & 0x4F == 0x08
    assert bus.control(0x80) & 0x4F == 0x40


def enabled(bus: Bus, mode: int) -> None:
    bus.sdo(f"2f 60 60 00 {mode:02x} 00 00 00")
    for word in (0x06, 0x07, 0x0F):
        bus.control(word)


def test_csv_turns_at_once_and_pv_by_its_ramp(bus: Bus) -> None:
    enabled(bus, 9)
    bus.sdo("23 ff 60 00 68 01 00 00")  # 360 units: 6 rpm, 36°/s
    assert bus.velocity_rad_s == pytest.approx(0.6283, abs=1e-3)
    bus.sdo("23 83 60 00 10 0e 00 00")  # 3600 units/s
    bus.sdo("2f 60 60 00 03 00 00 00")
    bus.sdo("23 ff 60 00 00 00 00 00")
    bus.step(49)
    assert bus.velocity_rad_s == pytest.approx(0.5 * 0.6283, rel=0.05)


def test_heartbeats_are_watched_from_the_first_one_on(bus: Bus) -> None:
    bus.sdo("23 16 10 01 32 00 7f 00")  # node 127, 50 ms
    assert bus.step(200) == []
    bus.send(0x77E, "05")
    assert bus.step(200) == []  # another's
    bus.send(0x77F, "05")
    assert bus.step(49) == []
    frames = bus.step(3)
    assert frames == [(0x083, bytes.fromhex("30 81 11 00 00 00 00 00"))]
    assert bus.send(0x77F, "05") == [(0x083, bytes(8))]


@pytest.mark.parametrize(("option", "state"), [(0, 0x27), (1, 0x08), (2, 0x40), (3, 0x40)])
def test_a_lost_host_is_answered_by_what_0x6007_says(bus: Bus, option: int, state: int) -> None:
    bus.sdo(f"2b 07 60 00 {option:02x} 00 00 00")
    bus.sdo("23 16 10 01 32 00 7f 00")
    enabled(bus, 9)
    bus.sdo("23 ff 60 00 68 01 00 00")
    bus.send(0x77F, "05")
    bus.step(100)
    assert bus.status() & (0x6F if state == 0x27 else 0x4F) == state
    assert (bus.velocity_rad_s == 0.0) == (option != 0)


def test_a_status_goes_out_at_a_sync_when_it_is_operational_and_mapped(bus: Bus) -> None:
    bus.sdo("23 00 18 01 83 01 00 c0")
    bus.sdo("2f 00 18 02 01 00 00 00")
    bus.sdo("2f 00 1a 00 00 00 00 00")
    bus.sdo("23 00 1a 01 10 00 41 60")
    bus.sdo("23 00 1a 02 20 00 64 60")
    bus.sdo("2f 00 1a 00 02 00 00 00")
    bus.sdo("23 00 18 01 83 01 00 40")
    assert bus.send(0x080, "") == []
    bus.send(0x000, "01 03")
    bus.encoder = -10_000  # 10° back, a hundred units
    bus.step()
    assert bus.send(0x080, "") == [(0x183, struct.pack("<Hi", 0x0250, -100))]
    assert bus.step(5) == []
