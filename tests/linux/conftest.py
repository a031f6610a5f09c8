"""A rig that is set up in the guest: the service on vcan0, and the bench as the rig at the other end.

The files are numbered in the order in which they run: set up, broken, without power, and taken away.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from needle_rig.errors import NeedleRigError
from needle_rig.service.client import DaemonClient

PROGRAM = "/opt/needle-rig/bin/needle-rig"
BENCH = Path(__file__).with_name("bench.yaml")
PORTS = Path("/run/bench")
SOCKET = Path("/run/needle-rig/daemon.sock")
RUNS = Path("/var/lib/needle-rig")
RIG_FILE = Path("/etc/needle-rig/rig.yaml")
MOVE = ("compensate", "--target", "30", "--settle", "1", "--no-picture")
BOOT_MARK = Path("/root/power-was-cut")
START_S = 120.0
"""The service's first start, on one emulated core."""


def shell(command: str, *, check: bool = True, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=timeout_s)
    assert not check or done.returncode == 0, f"{command}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done


def as_user(user: str, *command: str) -> list[str]:
    return ["setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups", "--reset-env", *command]


def needle_rig(*arguments: str, user: str = "tech") -> subprocess.CompletedProcess[str]:
    """`needle-rig` as a person types it at the rig's computer."""
    command = as_user(user, PROGRAM, *arguments)
    return subprocess.run(command, cwd=f"/home/{user}", capture_output=True, text=True, timeout=180)


def status() -> dict[str, Any]:
    """What the daemon says; asked from here, since an interpreter for each look would starve the rig."""
    try:
        return dict(DaemonClient(SOCKET).state())
    except NeedleRigError:
        return {}


def until(true: Callable[[], bool], what: str, within_s: float = 60.0) -> None:
    end_s = time.monotonic() + within_s
    while not true():
        if time.monotonic() > end_s:
            raise AssertionError(f"not within {within_s:g} s: {what}; {status().get('fault')}\n{journal()}")
        time.sleep(0.5)


def journal() -> str:
    """What the service said last, and how well its ticks keep their time."""
    said = shell("journalctl -u needle-rig --no-pager -n 30 -o cat").stdout
    return f"{said}ticks: {status().get('ticks')}" if active() else said


def active() -> bool:
    return shell("systemctl is-active needle-rig", check=False).stdout.strip() == "active"


def main_pid() -> int:
    return int(shell("systemctl show needle-rig -p MainPID --value").stdout)


def begun(process: subprocess.Popen[str], motion: str = "overshoot") -> None:
    """Wait until the base turns, in one motion of the run."""
    assert process.stderr is not None
    said = ""
    for line in process.stderr:
        if motion in line and "moving" in line:
            return
        said = line
    told = process.communicate()[0]
    raise AssertionError(f"it ended (exit {process.returncode}): {said}{told}{journal()}")


def started_run(*options: str) -> subprocess.Popen[str]:
    """A run that begins soon. What was written before goes to the disk first, as that takes the core too."""
    os.sync()
    return subprocess.Popen(
        as_user("tech", PROGRAM, *MOVE, *options),
        cwd="/home/tech",
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def order(name: str, content: dict[str, Any] | None = None) -> None:
    """An order to the daemon, as the command gives it, without an interpreter of its own."""
    client = DaemonClient(SOCKET)
    with client.lease("a test"):
        client.command(name, content)


def outcome() -> dict[str, Any]:
    """How one move ended."""
    done = needle_rig(*MOVE, "--json")
    told = dict(json.loads(done.stdout)) if done.stdout else {"status": "none", "message": done.stderr}
    return {"code": done.returncode, "stderr": done.stderr, **told}


class Rig:
    """The bench, which is switched on and off like a rig."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def switch_on(self, link: str = "", interface: str | None = "vcan0") -> None:
        """With a line more among its links, as for another drive; without `interface` it is an slcan port."""
        PORTS.mkdir(exist_ok=True)
        config = PORTS / "bench.yaml"
        config.write_text(BENCH.read_text().replace("links:", f"links:\n{link.rstrip()}#", 1))
        command = [sys.executable, "-m", "needle_rig.simulation.bench"]
        bus = [] if interface is None else ["--can", interface]
        self._process = subprocess.Popen(
            [*command, *bus, "--config", str(config), "--ports", str(PORTS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self._process.stdout is not None
        said = json.loads(self._process.stdout.readline())
        assert "error" not in said, said
        # a serial adapter would belong to dialout, by the udev rule
        os.chmod((PORTS / "hall").resolve(), 0o666)

    def tell(self, line: str) -> None:
        """Break a link of it, or mend it, in the bench's words."""
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n".encode())
        self._process.stdin.flush()

    def cleared(self) -> bool:
        """Whether no fault stands; a fault is cleared, and a drive that was off told its angle."""
        if status().get("fault", "") is None:
            return True
        with contextlib.suppress(NeedleRigError):
            order("clear")
            self.refer()
        return status().get("fault", "") is None

    def refer(self) -> None:
        """Let the base's angle be known, by the first Hall sensor."""
        order("home", {"by": "hall", "angle_deg": 0.0, "speed_deg_s": 10.0})
        until(lambda: not status().get("moving", True), "the base's angle is known")

    def switch_off(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


@pytest.fixture(scope="session")
def users() -> None:
    if BOOT_MARK.exists():
        return
    for name in ("tech", "guest"):
        shell(f"useradd --create-home {name}")


@pytest.fixture(scope="session")
def installed(users: None) -> None:
    """The service as one command sets it up, with tick and ages of links that one emulated core can keep."""
    if BOOT_MARK.exists():
        return
    shell(
        f"{PROGRAM} install-service --name guest --can vcan0 --hall {PORTS}/hall --member tech --no-start",
        timeout_s=180,
    )
    text = RIG_FILE.read_text().replace("tick_hz: 200", "tick_hz: 100")
    RIG_FILE.write_text(text.replace("_age_limit_ms: 50", "_age_limit_ms: 500"))


@pytest.fixture
def power_back(the_rig: Rig) -> Rig:
    """The rig, which the computer finds switched on after the power came back."""
    the_rig.switch_on()
    until(lambda: active() and status().get("sensors") is not None, "the service runs", START_S)
    until(at_rest, "every link is young", 60)
    until(the_rig.cleared, "no fault stands")
    the_rig.refer()
    return the_rig


@pytest.fixture(scope="session")
def service(installed: None) -> None:
    shell("systemctl start needle-rig", timeout_s=START_S)


@pytest.fixture(scope="session")
def the_rig() -> Iterator[Rig]:
    rig = Rig()
    yield rig
    rig.switch_off()


@pytest.fixture
def rig(service: None, the_rig: Rig) -> Rig:
    """The rig, on, referenced and at rest behind a running service."""
    if not active():
        shell("systemctl start needle-rig", timeout_s=START_S)
    if the_rig._process is None:
        the_rig.switch_on()
    until(lambda: active() and status().get("sensors") is not None, "the service runs")
    until(at_rest, "every link is young", 60)
    until(the_rig.cleared, "no fault stands")
    the_rig.refer()
    return the_rig


def cut_run_told() -> bool:
    """Whether `status` tells how a run ended that the daemon before left open."""
    return any(run["text"] for run in status().get("unfinished", []))


def at_rest() -> bool:
    ages = (status().get("sensors") or {}).get("age_ms", {"none": None})
    return all(age is not None and age < 200 for age in ages.values())
