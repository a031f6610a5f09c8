"""The hub against python-can's own, unchanged slcan: what passes here works with any adapter."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Callable, Iterator

import can
import pytest
from can.interfaces.slcan import slcanBus

from needle_rig.simulation.nodes.slcan_hub import Frame, SlcanHub, SlcanPort


@pytest.fixture
def hub() -> Iterator[SlcanHub]:
    hub = SlcanHub()
    yield hub
    for port in list(hub.ports):
        hub.remove_port(port)


@pytest.fixture
def bus_on(hub: SlcanHub) -> Iterator[Callable[[SlcanPort], slcanBus]]:
    """Opens python-can's bus on a port of the hub; closed before the hub, whatever the test found."""
    with contextlib.ExitStack() as buses:

        def opened(port: SlcanPort) -> slcanBus:
            bus = buses.enter_context(slcanBus(port.name, bitrate=1_000_000, sleep_after_open=0, timeout=1.0))
            serve_until(hub, port, lambda: port.is_open)
            return bus

        yield opened


def serve_until(hub: SlcanHub, port: SlcanPort, reached: Callable[[], bool]) -> None:
    """Pass on what comes into `port`: a terminal brings it a moment after it was written, and in pieces."""
    while not reached():
        assert select.select([port], [], [], 5.0)[0]
        hub.serve(port)
        hub.flush()


def received(bus: slcanBus) -> Frame | None:
    for _ in range(20):  # answers to commands count as lines without a frame
        message = bus.recv(0.5)
        if message is not None:
            return message.arbitration_id, bytes(message.data)
    return None


def test_frames_pass_between_two_programs_and_a_node(
    hub: SlcanHub, bus_on: Callable[[SlcanPort], slcanBus]
) -> None:
    heard: list[Frame] = []
    hub.attach(heard.append)
    ports = hub.add_port(), hub.add_port()
    buses = [bus_on(port) for port in ports]
    buses[0].send(can.Message(arbitration_id=0x110, data=b"\x01\xff\x0d", is_extended_id=False))
    serve_until(hub, ports[0], lambda: bool(heard))
    assert received(buses[1]) == (0x110, b"\x01\xff\x0d")
    assert heard == [(0x110, b"\x01\xff\x0d")]
    hub.send((0x101, b"12345678"), sender=heard.append)
    hub.flush()
    assert [received(bus) for bus in buses] == [(0x101, b"12345678")] * 2
    assert len(heard) == 1


def test_a_closed_channel_hears_and_says_nothing(
    hub: SlcanHub, bus_on: Callable[[SlcanPort], slcanBus]
) -> None:
    port = hub.add_port()
    bus = bus_on(port)
    bus.close()
    bus.send(can.Message(arbitration_id=1, data=b"", is_extended_id=False))
    serve_until(hub, port, lambda: not port.is_open)
    assert port.receive() == []
    hub.send((1, b""))
    hub.flush()
    assert bus.recv(0) is None


def test_the_version_is_told(hub: SlcanHub) -> None:
    port = hub.add_port()
    descriptor = os.open(port.name, os.O_RDWR | os.O_NOCTTY)
    os.write(descriptor, b"V\rnonsense\r")
    answer = b""
    while not answer.endswith(b"\a"):
        assert select.select([port], [], [], 5.0)[0]
        hub.serve(port)
        hub.flush()
        answer += os.read(descriptor, 64)
    assert answer == b"V0101\r\a"
    os.close(descriptor)


def test_a_program_that_does_not_read_costs_frames_and_no_time(
    hub: SlcanHub, bus_on: Callable[[SlcanPort], slcanBus]
) -> None:
    port = hub.add_port()
    bus_on(port)
    for _ in range(20_000):
        hub.send((0x101, b"12345678"))
        hub.flush()
    assert port.lost > 0
