"""A daemon that runs already: used by every command over its socket, by one daemon only, told to systemd."""

import fcntl
import json
import os
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest

from needle_rig.recording import RunFile, new_run, run_tables
from tests.closed_loop.shell import PROGRAM, ROOT, Shell, all_gone, wait_for_line


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    shell = Shell(tmp_path)
    yield shell
    all_gone(shell.processes())


@pytest.fixture
def daemon(shell: Shell) -> Iterator[subprocess.Popen[str]]:
    """A daemon in virtual time at the place where clients look first."""
    with shell.start("daemon", "--fast") as process:
        wait_for_line(process, lambda line: "ready" in line)
        yield process


def ask(shell: Shell, method: str, path: str, **content: Any) -> httpx.Response:
    place = shell.folder / "run" / "needle-rig" / "daemon.sock"
    with httpx.Client(transport=httpx.HTTPTransport(uds=str(place)), base_url="http://daemon") as client:
        return client.request(method, path, **content)


@pytest.mark.whole
def test_commands_use_the_running_daemon(shell: Shell, daemon: subprocess.Popen[str]) -> None:
    place = shell.folder / "run" / "needle-rig" / "daemon.sock"
    assert stat.S_IMODE(place.stat().st_mode) == 0o660
    status = shell.run("status")
    assert status.returncode == 0, status.stderr
    assert "phase:   0%  idle" in status.stdout
    assert str(place) in status.stdout
    result = shell.compensate("--settle", "0.5")
    assert len(shell.processes()) == 3, "the daemon, its recorder and its API go on"
    assert (shell.folder / result["run"]).exists()
    state = json.loads(shell.run("status", "--json").stdout)
    assert state["last"]["result"] == result
    assert state["phase"] == "done"
    assert state["ticks"]["missed"] == 0
    daemon.send_signal(signal.SIGTERM)
    assert daemon.wait(30) == 0
    assert not place.exists()


@pytest.mark.whole
def test_stop_ends_the_run_of_another_client(shell: Shell, daemon: subprocess.Popen[str]) -> None:
    with shell.start("compensate", "--target", "45", "--settle", "600", "--no-picture") as client:
        wait_for_line(client, lambda line: "settling" in line)
        second = shell.run("compensate", "--target", "45", "--no-picture")
        assert second.returncode == 2
        assert "(needle-rig compensate, process" in second.stderr
        assert "commands this rig" in second.stderr
        cleared = shell.run("clear")
        assert cleared.returncode == 2
        assert "commands this rig" in cleared.stderr
        assert shell.run("stop", "--reason", "lunch").returncode == 0
        out, _ = client.communicate(timeout=60)
    assert client.returncode == 4
    assert "lunch" in out
    assert shell.run("clear").returncode == 0
    assert shell.compensate("--settle", "0.2")["motions"]


@pytest.mark.whole
def test_sigterm_in_mid_run_stops_the_drive_and_closes_the_run(
    shell: Shell, daemon: subprocess.Popen[str]
) -> None:
    with shell.start("compensate", "--target", "45", "--settle", "600", "--no-picture") as client:
        wait_for_line(client, lambda line: "settling" in line)
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(30) == 0
        _, err = client.communicate(timeout=60)
    assert client.returncode == 4, err
    (path,) = (shell.folder / "runs").glob("*.h5")
    run = RunFile(path)
    assert run.complete
    assert run.result is not None
    assert run.result["status"] == "aborted"
    assert not run.table("ticks")[-1]["enable"]


@pytest.mark.whole
def test_a_run_that_was_cut_off_is_told_at_the_next_start(shell: Shell) -> None:
    left = new_run(shell.folder / "runs", {"strategy": "reed2008", "target_deg": 45.0}, run_tables(4))
    left.append("torque", [(1.0, 0.5, 7, 1e-4)])
    left.leave()
    with shell.start("daemon", "--fast") as daemon:
        wait_for_line(daemon, lambda line: "unfinished run" in line and "text=" in line)
        told = shell.run("status")
        assert f"cut off: the daemon or its computer went before the run ended: {left.path}" in told.stdout
        assert "cut off" in shell.run("runs").stdout
        assert len(RunFile(left.path).table("torque")) == 1
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(30) == 0


@pytest.mark.whole
def test_a_second_daemon_is_refused(shell: Shell, daemon: subprocess.Popen[str]) -> None:
    second = shell.run("daemon", "--fast")
    assert second.returncode == 3
    assert second.stderr.splitlines()[-1].endswith(
        "another daemon listens there; use it, stop it, or choose another --socket"
    )
    assert "Traceback" not in second.stderr


BAD_REQUESTS = [
    ("/compensate", b"{}", "target_deg"),
    ("/compensate", b"not json", "json"),
    ("/compensate", b'{"target_deg": 45, "extra": 1}', "extra"),
    ("/compensate", b'{"target_deg": NaN}', "target_deg"),
    ("/compensate", b'{"target_deg": 45, "settle_s": -1}', "settle_s"),
    ("/compensate", b'{"target_deg": 1e9}', "3600"),
    ("/compensate", b'{"target_deg": 721}', "outside"),
    ("/compensate", b'{"target_deg": true}', "target_deg"),
    ("/compensate", b'{"target_deg": 5, "strategy": "a\\u0000b"}', "strategy"),
    ("/compensate", b'{"target_deg": 45, "options": {"a": 1}}', "no option 'a'"),
    ("/compensate", b'{"target_deg": 45, "strategy": "nonsense"}', "reed2008"),
    ("/stop", b'{"reason": ""}', "reason"),
]


def test_a_bad_request_is_one_sentence(shell: Shell, daemon: subprocess.Popen[str]) -> None:
    for path, body, wanted in BAD_REQUESTS:
        answer = ask(shell, "POST", path, content=body)
        assert answer.status_code == 422, body[:50]
        assert wanted in answer.json()["error"].lower()
        assert answer.json()["exit_code"] == 2
    for body in (b"[" * 66_000, b"[" * 2_000_000):
        answer = ask(shell, "POST", "/compensate", content=body)
        assert (answer.status_code, answer.json()["exit_code"]) == (413, 2)
    assert ask(shell, "GET", "/nowhere").json()["exit_code"] == 2
    assert ask(shell, "PUT", "/state").status_code == 405
    assert ask(shell, "GET", "/state").json()["phase"] == "idle"
    assert not list(shell.folder.glob("runs/*"))


@pytest.mark.real_time
def test_systemd_is_told(shell: Shell) -> None:
    told = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    told.bind(str(shell.folder / "notify"))
    told.settimeout(60)
    environment = {
        **shell.environment,
        "NOTIFY_SOCKET": str(shell.folder / "notify"),
        "WATCHDOG_USEC": "200000",
    }
    with ExitStack() as stack:
        stack.callback(told.close)
        process = subprocess.Popen(
            [*PROGRAM, "daemon"],
            cwd=shell.folder,
            env=environment,
            stderr=subprocess.DEVNULL,
        )
        stack.callback(process.wait)
        stack.callback(process.kill)
        starting = []
        while not (text := told.recv(500)).startswith(b"READY=1"):
            starting.append(text)
        # a start that compiles the solver takes longer than the unit's TimeoutStartSec
        assert starting[0] == b"EXTEND_TIMEOUT_USEC=15000000"
        assert any(text.startswith(b"STATUS=starting") for text in starting)
        # in real time, from ticks that met their deadline
        while told.recv(500) != b"WATCHDOG=1":
            pass
        process.send_signal(signal.SIGTERM)
        while told.recv(500) != b"STOPPING=1":
            pass
        assert process.wait(30) == 0


@pytest.mark.whole
def test_a_daemon_that_cannot_open_its_rig_says_so(shell: Shell) -> None:
    rig = (ROOT / "config" / "rig.yaml").read_text().replace("channel: auto", "channel: /dev/ttyNONE")
    (shell.folder / "rig.yaml").write_text(rig)
    done = shell.run("daemon", "--config", "rig.yaml", "--socket", "here.sock")
    assert done.returncode == 3
    assert "/dev/ttyNONE" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


@pytest.mark.whole
def test_a_port_serves_one_daemon(shell: Shell) -> None:
    master, slave = os.openpty()
    try:
        name = os.ttyname(slave)
        rig = (ROOT / "config" / "rig.yaml").read_text().replace("channel: auto", f"channel: {name}")
        (shell.folder / "rig.yaml").write_text(rig)
        fcntl.flock(slave, fcntl.LOCK_EX | fcntl.LOCK_NB)  # as the first daemon does
        done = shell.run("compensate", "--target", "45", "--config", "rig.yaml")
        assert done.returncode == 3
        assert name in done.stderr
        assert "in use" in done.stderr
        assert len(done.stderr.splitlines()) == 1
    finally:
        os.close(master)
        os.close(slave)


@pytest.mark.whole
def test_a_rig_that_comes_after_its_daemon_is_found(shell: Shell, tmp_path: Path) -> None:
    rig = (ROOT / "config" / "rig.yaml").read_text()
    rig = rig.replace("channel: auto", f"channel: {tmp_path}/can").replace(
        "port: auto", f"port: {tmp_path}/hall"
    )
    (shell.folder / "rig.yaml").write_text(rig)
    with shell.start("daemon", "--config", "rig.yaml", "--socket", "here.sock") as daemon:
        line = wait_for_line(daemon, lambda line: "no rig yet" in line)
        assert f"there is no {tmp_path}/can" in line
        wait_for_line(daemon, lambda line: "ready" in line)
        told = shell.run("status", "--socket", "here.sock")
        assert told.returncode == 0
        assert f"there is no {tmp_path}/can" in told.stdout
        bench = subprocess.Popen(
            [sys.executable, "-m", "needle_rig.simulation.bench", "--ports", str(tmp_path)],
            cwd=shell.folder,
            env=shell.environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
        )
        try:
            wait_for_line(daemon, lambda line: "the rig answers" in line)
            done = shell.run("jog", "--by", "1", "--socket", "here.sock")
            assert done.returncode == 0, done.stderr
        finally:
            bench.kill()
            bench.communicate()


@pytest.mark.whole
def test_term_ends_a_daemon_whose_bench_is_still_starting(shell: Shell) -> None:
    # a cache of its own: the bench compiles for a quarter of a minute
    environment = {**shell.environment, "NUMBA_CACHE_DIR": str(shell.folder / "cache")}
    process = subprocess.Popen(
        [*PROGRAM, "daemon"], cwd=shell.folder, env=environment, stderr=subprocess.PIPE, text=True
    )
    try:
        time.sleep(4.0)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=8.0)
    finally:
        process.kill()
    assert process.returncode == 0
    assert "ended" in said
    assert "ready" not in said
    all_gone(shell.processes(), within_s=5.0)
