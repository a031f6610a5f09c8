"""Datagrams and pages over real sockets of this computer."""

from __future__ import annotations

import errno
import socket
import threading
from collections.abc import Iterator

import pytest

from needle_rig.devices.ethernet import UdpPort, fetch_page
from needle_rig.devices.ports import network_reason
from needle_rig.errors import RigFault


@pytest.fixture
def other_end() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        made.settimeout(10)
        yield made


def test_datagrams_go_both_ways_and_from_one_address_alone(other_end: socket.socket) -> None:
    got: list[bytes] = []
    port = UdpPort("torque", "127.0.0.1", other_end.getsockname()[1], lambda data, now_s: got.append(data))
    assert not port.send(b"closed")
    port.open()
    try:
        assert port.send(b"asked")
        data, sender = other_end.recvfrom(100)
        assert data == b"asked"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(b"from elsewhere", sender)
        other_end.sendto(b"told", sender)
        port.poll()
        assert got == [b"told"]
        port.poll()
        assert got == [b"told"]
    finally:
        port._release()


def test_an_address_that_nobody_has_is_one_sentence() -> None:
    port = UdpPort("torque", "no.such.address.invalid", 49152, lambda data, now_s: None)
    with pytest.raises(RigFault) as refused:
        port.open()
    told = str(refused.value)
    assert told.startswith("Torque link (no.such.address.invalid): ")
    assert told.endswith("; see links.torque in the rig file")
    assert "\n" not in told


def served(answer: bytes) -> tuple[int, threading.Thread]:
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with server, server.accept()[0] as client:
            client.recv(4096)
            client.sendall(answer)

    thread = threading.Thread(target=serve)
    thread.start()
    return int(server.getsockname()[1]), thread


def page(answer: bytes) -> bytes:
    port, thread = served(answer)
    try:
        return fetch_page("127.0.0.1", port, "netftapi2.xml")
    finally:
        thread.join()


def test_a_page_is_fetched() -> None:
    assert page(b"HTTP/1.0 200 OK\r\n\r\n<netft/>") == b"<netft/>"


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (b"HTTP/1.0 404 Not Found\r\n\r\n", "answers 404 Not Found; is this the sensor's address?"),
        (b"SSH-2.0-OpenSSH\r\n", "no page: SSH-2.0-OpenSSH"),
        (b"HTTP/1.0 200 OK\r\n\r\n" + bytes(300_000), "longer than 256 kB"),
        (b"", "no page: "),
    ],
)
def test_what_is_no_page_is_one_sentence(answer: bytes, told: str) -> None:
    with pytest.raises(RigFault) as refused:
        page(answer)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (
            OSError(errno.EPERM, "x"),
            "sudo needle-rig install-service, then: sudo systemctl restart needle-rig",
        ),
        (OSError(errno.EAFNOSUPPORT, "x"), "sudo needle-rig install-service"),
        (OSError(errno.EHOSTUNREACH, "x"), "no route to host; is it on, and this its address?"),
        (TimeoutError("timed out"), "nobody answers; is it on"),
        (socket.gaierror(-2, "x"), "no such address"),
    ],
)
def test_errors_of_the_network_say_what_to_do(error: OSError, told: str) -> None:
    assert told in network_reason(error)
