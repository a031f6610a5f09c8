import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from needle_rig.service.tick.notify import Notify

UNIT = Path(__file__).parents[3] / "config" / "service" / "needle-rig.service"


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        yield listener


def test_states_reach_the_socket(systemd: socket.socket) -> None:
    notify = Notify({"NOTIFY_SOCKET": systemd.getsockname()})
    notify.send(READY=1, STATUS="idle")
    assert systemd.recv(200) == b"READY=1\nSTATUS=idle"
    notify.close()


def test_an_abstract_socket_is_reached() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(f"\0needle-rig-test-{os.getpid()}")
        notify = Notify({"NOTIFY_SOCKET": f"@needle-rig-test-{os.getpid()}"})
        notify.send(STOPPING=1)
        assert listener.recv(200) == b"STOPPING=1"
        notify.close()


def test_the_watchdog_is_fed_four_times_in_its_time_and_only_when_called(systemd: socket.socket) -> None:
    notify = Notify({"NOTIFY_SOCKET": systemd.getsockname(), "WATCHDOG_USEC": "1000000"})
    assert notify.watchdog_s == 1.0
    for tick in range(200):
        notify.alive(100.0 + tick * 0.005)
    fed = 0
    while True:
        try:
            assert systemd.recv(200) == b"WATCHDOG=1"
        except BlockingIOError:
            break
        fed += 1
    assert fed == 4
    notify.close()


@pytest.mark.parametrize(
    "environment",
    [{}, {"NOTIFY_SOCKET": "/nowhere/at/all"}, {"WATCHDOG_USEC": "5", "WATCHDOG_PID": "1"}],
    ids=["no systemd", "socket gone", "watchdog of another process"],
)
def test_it_is_silent_where_nobody_listens(environment: dict[str, str]) -> None:
    notify = Notify(environment)
    notify.send(READY=1)
    notify.alive(1.0)
    assert notify.watchdog_s == 0.0
    notify.close()


def test_a_full_socket_does_not_hold_up_the_tick(systemd: socket.socket) -> None:
    notify = Notify({"NOTIFY_SOCKET": systemd.getsockname()})
    for _ in range(5000):
        notify.send(STATUS="x" * 500)
    notify.close()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_the_unit_is_clean() -> None:
    checked = subprocess.run(
        ["systemd-analyze", "verify", str(UNIT)], capture_output=True, text=True, timeout=60
    )
    assert checked.stdout + checked.stderr == ""
    assert checked.returncode == 0
