"""The API's process dies, hangs or outlives its daemon; signals come at any time; nothing is left behind."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from needle_rig.recording import RunFile
from needle_rig.service.client import DaemonClient
from tests.closed_loop.shell import Shell, all_gone, wait_for_line


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    with tempfile.TemporaryDirectory(prefix="nr-") as temporary:  # a socket's path must be short
        shell = Shell(tmp_path, temporary=temporary)
        yield shell
        all_gone(shell.processes())


@pytest.fixture
def daemon(shell: Shell) -> Iterator[subprocess.Popen[str]]:
    with shell.start("daemon", "--fast") as process:
        wait_for_line(process, lambda line: "ready" in line)
        yield process


def the_socket(shell: Shell) -> Path:
    return shell.folder / "run" / "needle-rig" / "daemon.sock"


def process_of(shell: Shell, name: str) -> int:
    (found,) = (pid for pid, line in shell.processes().items() if name in line)
    return found


def threads(process: subprocess.Popen[str]) -> int:
    return len(list(Path(f"/proc/{process.pid}/task").iterdir()))


def left_behind(shell: Shell) -> list[Path]:
    return [*Path(shell.temporary).iterdir(), *the_socket(shell).parent.iterdir()]


def wait_until_gone(shell: Shell, within_s: float = 10.0) -> None:
    deadline_s = time.monotonic() + within_s
    while (left := left_behind(shell)) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert not left


@pytest.mark.whole
def test_a_run_and_its_client_outlive_the_api_process(shell: Shell, daemon: subprocess.Popen[str]) -> None:
    with shell.start("compensate", "--target", "45", "--settle", "600", "--no-picture") as client:
        wait_for_line(client, lambda line: "settling" in line)
        for _ in range(2):
            os.kill(process_of(shell, "api_process"), signal.SIGKILL)
            assert DaemonClient(the_socket(shell)).state()["run"] is not None
        client.send_signal(signal.SIGINT)
        out, err = client.communicate(timeout=60)
    assert client.returncode == 4, err
    assert "Ctrl-C" in out
    (path,) = (shell.folder / "runs").glob("*.h5")
    assert RunFile(path).complete
    daemon.send_signal(signal.SIGTERM)
    assert daemon.wait(30) == 0
    _, log = daemon.communicate()
    assert log.count("started again") == 1
    wait_until_gone(shell)


SIGNALS = [
    signal.SIGHUP,
    pytest.param(signal.SIGTERM, marks=pytest.mark.slow),
    pytest.param(signal.SIGINT, marks=pytest.mark.slow),
]


@pytest.mark.whole
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_closes_the_run_and_leaves_nothing(
    shell: Shell, daemon: subprocess.Popen[str], number: signal.Signals
) -> None:
    with shell.start("compensate", "--target", "45", "--settle", "600", "--no-picture") as client:
        wait_for_line(client, lambda line: "settling" in line)
        daemon.send_signal(number)
        assert daemon.wait(30) == 0
        client.communicate(timeout=60)
    (path,) = (shell.folder / "runs").glob("*.h5")
    run = RunFile(path)
    assert run.complete
    assert not run.table("ticks")[-1]["enable"]
    wait_until_gone(shell, 0)


def test_a_killed_daemon_leaves_nothing(shell: Shell, daemon: subprocess.Popen[str]) -> None:
    alive = shell.processes()
    assert the_socket(shell).is_socket()
    daemon.kill()
    all_gone(alive)
    wait_until_gone(shell)


@pytest.mark.whole
def test_a_signal_before_the_daemon_is_ready_leaves_nothing(shell: Shell) -> None:
    the_socket(shell).parent.mkdir(parents=True)
    for delay_s in (0.4, 0.7, 1.0):
        with shell.start("daemon", "--fast") as process:
            time.sleep(delay_s)
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) in (0, -signal.SIGTERM)
        wait_until_gone(shell)


def test_what_is_no_socket_stays(shell: Shell) -> None:
    (shell.folder / "letter.txt").write_text("dear")
    done = shell.run("daemon", "--fast", "--socket", "letter.txt")
    assert done.returncode == 2
    assert "is no socket" in done.stderr.splitlines()[-1]
    assert (shell.folder / "letter.txt").read_text() == "dear"


@pytest.mark.whole
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_to_the_client_while_its_run_starts_stops_it(
    shell: Shell, daemon: subprocess.Popen[str], number: signal.Signals
) -> None:
    recorder = process_of(shell, "recorder_process")
    os.kill(recorder, signal.SIGSTOP)
    try:
        with shell.start("compensate", "--target", "60", "--no-picture") as client:
            deadline_s = time.monotonic() + 30
            # with the lease it is about to ask; the thread of its stream starts once it catches signals
            while DaemonClient(the_socket(shell)).state()["lease"] is None or threads(client) == 1:
                assert time.monotonic() < deadline_s
                time.sleep(0.01)
            time.sleep(0.3)
            client.send_signal(number)
            _, err = client.communicate(timeout=30)
    finally:
        with contextlib.suppress(ProcessLookupError):  # the daemon kills one that was silent for 10 s
            os.kill(recorder, signal.SIGCONT)
    said = "stopping …\nStopped: the drive is stopped, and nothing begins.\n"
    assert (client.returncode, err) == (4, said)
    time.sleep(0.5)
    state = DaemonClient(the_socket(shell)).state()
    assert (state["run"], state["phase"], state["lease"]) == (None, "aborted", None)
    sensors = state["sensors"]
    assert sensors is not None
    assert sensors["base_deg"] == pytest.approx(0.0, abs=0.1)
    assert not list(shell.folder.glob("runs/*"))
    assert shell.compensate("--settle", "0.2")["motions"]


@pytest.mark.whole
def test_jog_home_hold_and_release(shell: Shell, daemon: subprocess.Popen[str]) -> None:
    assert shell.run("jog", "--by", "5").stdout.startswith("The base stands at 5.0")
    assert shell.run("jog", "--to", "-10", "--speed", "20").stdout.startswith("The base stands at -10.0")
    home = shell.run("home")
    assert home.returncode == 0, home.stderr
    assert shell.run("hold").returncode == 0
    assert shell.run("jog", "--by", "5").returncode in (2, 3)
    assert shell.run("release").returncode == 0
    for bad, told in (
        (["jog"], "--by"),
        (["jog", "--by", "1e9"], "by_deg"),
        (["home", "--here", "9999"], "3600"),
    ):
        done = shell.run(*bad)
        assert done.returncode == 2
        assert told in done.stderr
    assert not list(shell.folder.glob("runs/*"))


@pytest.mark.whole
def test_a_motion_is_stopped_by_ctrl_c(shell: Shell, daemon: subprocess.Popen[str]) -> None:
    with shell.start("jog", "--to", "700", "--speed", "0.5") as client:
        wait_for_line(client, lambda line: "moving" in line)
        second = shell.run("home")
        assert second.returncode == 2
        assert "commands this rig" in second.stderr
        client.send_signal(signal.SIGINT)
        _, err = client.communicate(timeout=30)
    assert client.returncode == 4
    assert "stopping …" in err.splitlines()
    assert err.splitlines()[-1] == "Stopped: the drive is stopped."
    assert DaemonClient(the_socket(shell)).state()["phase"] == "aborted"


def test_commands_without_a_daemon_say_so(shell: Shell) -> None:
    for command in (["jog", "--by", "1"], ["home"], ["hold"], ["release"]):
        done = shell.run(*command)
        assert done.returncode == 3
        assert "start one: needle-rig daemon" in done.stderr


@pytest.mark.whole
def test_a_few_descriptors_are_enough_for_many_idle_clients(shell: Shell) -> None:
    command = ["sh", "-c", 'ulimit -n 200; exec "$@"', "sh"]
    with shell.start("daemon", "--fast", before=command) as daemon, contextlib.ExitStack() as stack:
        wait_for_line(daemon, lambda line: "ready" in line)
        for _ in range(400):
            idle = stack.enter_context(socket.socket(socket.AF_UNIX))
            idle.settimeout(5)
            idle.connect(str(the_socket(shell)))
        stopped = shell.run("stop")
        assert stopped.returncode == 0, stopped.stderr
        assert json.loads(shell.run("status", "--json").stdout)["phase"] == "aborted"
        daemon.send_signal(signal.SIGTERM)
        _, log = daemon.communicate(timeout=30)
    assert daemon.returncode == 0
    assert len(log.splitlines()) < 10, log
