"""What can be said of SocketCAN without an interface; the rest is tested in the guest (tests/linux)."""

from __future__ import annotations

import errno
import os

import pytest

from needle_rig.devices.ports import claim_interface, interface_reason
from needle_rig.errors import BadInput
from needle_rig.simulation.bench.socketcan_port import SocketCanPort


def test_a_bench_without_its_interface_says_how_to_make_one() -> None:
    with pytest.raises(BadInput, match="--can nrnone0: ") as told:
        SocketCanPort("nrnone0")
    assert "sudo " in str(told.value)


def test_an_interface_serves_one_daemon_and_is_free_when_it_is_let_go() -> None:
    held = claim_interface("nrtest0")
    with pytest.raises(OSError) as told:
        claim_interface("nrtest0")
    assert told.value.errno == errno.EADDRINUSE
    assert "in use by another needle-rig" in interface_reason(errno.EADDRINUSE, "nrtest0")
    os.close(claim_interface("nrtest1"))
    os.close(held)
    os.close(claim_interface("nrtest0"))


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.ENODEV, "there is no interface can0"),
        (errno.ENXIO, "there is no interface can0"),
        (errno.ENETDOWN, "can0 is down"),
        (errno.EPERM, "no right to use can0"),
        (errno.ENOBUFS, "No buffer space"),
    ],
    ids=errno.errorcode.get,
)
def test_why_an_interface_cannot_be_used_is_said_in_words(code: int, words: str) -> None:
    assert words in interface_reason(code, "can0")
    assert "Errno" not in interface_reason(code, "can0")
