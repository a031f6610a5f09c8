"""The service of a real rig: installed, started without its rig, used, broken, and taken away."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.linux.conftest import (
    BENCH,
    MOVE,
    PORTS,
    PROGRAM,
    RIG_FILE,
    RUNS,
    START_S,
    Rig,
    active,
    as_user,
    begun,
    cut_run_told,
    journal,
    main_pid,
    needle_rig,
    outcome,
    shell,
    started_run,
    status,
    until,
)

pytestmark = pytest.mark.linux


def test_it_is_set_up_by_one_command_and_twice_changes_nothing(installed: None) -> None:
    again = shell(f"{PROGRAM} install-service --no-start").stdout
    assert "nothing was changed" in again
    assert "vcan0" in shell("ip -brief link show type vcan").stdout
    assert shell("systemd-analyze verify needle-rig.service").stdout == ""
    assert "needle-rig" in shell("id -nG tech").stdout


def test_a_second_installation_moves_unit_and_link_and_what_is_not_ours_stays(installed: None) -> None:
    link, second = Path("/usr/local/bin/needle-rig"), Path("/opt/needle-rig-2")
    second.symlink_to("/opt/needle-rig")
    shell(f"{second}/bin/python -m needle_rig install-service --no-start")
    assert link.readlink() == second / "bin/needle-rig"
    assert f"PATH={second}/bin:" in shell("systemctl cat needle-rig").stdout
    link.unlink()
    link.symlink_to("/usr/bin/env")
    told = shell(f"{PROGRAM} install-service --no-start")
    assert "was not made by this service and stays" in told.stderr
    assert link.readlink() == Path("/usr/bin/env")
    link.unlink()
    shell(f"{PROGRAM} install-service --no-start")
    assert link.readlink() == Path(PROGRAM)


def test_where_the_service_is_down_nobody_gets_a_simulated_rig(installed: None) -> None:
    done = needle_rig(*MOVE)
    assert done.returncode == 3
    assert "a rig is set up here" in done.stderr
    assert "sudo systemctl start needle-rig" in done.stderr
    assert not Path("/home/tech/runs").exists()


def test_it_starts_without_its_rig_and_says_what_is_missing(service: None) -> None:
    assert active()
    until(lambda: status().get("fault") is not None, "a fault is told")
    assert "/run/bench/hall" in status()["fault"]
    done = needle_rig(*MOVE)
    assert done.returncode == 3
    assert "/run/bench/hall" in done.stderr


def test_a_rig_that_is_switched_on_later_is_found(rig: Rig) -> None:
    assert status()["fault"] is None
    assert needle_rig("status").returncode == 0


def test_a_technician_turns_the_needle_and_finds_the_run(rig: Rig) -> None:
    result = outcome()
    assert result["code"] == 0, result["stderr"] + journal()
    assert Path(result["run"]).parent == RUNS
    listed = json.loads(needle_rig("runs", "--json").stdout)
    assert listed[-1]["path"] == result["run"]
    exported = needle_rig("export", "last", "--csv", "--out", "/home/tech/out")
    assert exported.returncode == 0, exported.stderr


def test_who_is_not_in_the_group_may_not_talk_to_it(rig: Rig) -> None:
    done = needle_rig("status", user="guest")
    assert done.returncode == 2
    assert "join the socket's group" in done.stderr


def test_it_has_real_time_priority_its_children_have_not_and_all_are_caged(rig: Rig) -> None:
    daemon = main_pid()
    assert "SCHED_FIFO" in shell(f"chrt --pid {daemon}").stdout
    members = Path("/sys/fs/cgroup/system.slice/needle-rig.service/cgroup.procs").read_text().split()
    children = [pid for pid in members if int(pid) != daemon]
    assert children
    for child in children:
        assert "SCHED_FIFO" not in shell(f"chrt --pid {child}").stdout
    for pid in (daemon, *children):
        told = dict(
            line.split(":\t", 1)
            for line in Path(f"/proc/{pid}/status").read_text().splitlines()
            if ":\t" in line
        )
        assert told["NoNewPrivs"] == "1"
        assert told["Seccomp"] == "2"
        assert int(told["CapEff"], 16) == 0
    exposure = shell("systemd-analyze security needle-rig.service --no-pager | tail -1").stdout
    assert float(exposure.split(":")[1].split()[0]) <= 2.0, exposure


def test_a_start_with_its_rig_leaves_nothing_alarming_in_the_log(rig: Rig) -> None:
    begun_s = time.time()
    shell("systemctl restart needle-rig", timeout_s=120)
    until(lambda: status().get("fault") is None and status().get("sensors") is not None, "it runs")
    time.sleep(5.0)
    invocation = shell("systemctl show needle-rig -p InvocationID --value").stdout.strip()
    said = shell(f"journalctl _SYSTEMD_INVOCATION_ID={invocation} --no-pager -o cat").stdout
    assert said
    alarming = [line for line in said.splitlines() if "error" in line.lower() or "is dead" in line]
    assert alarming == []
    assert len(said.splitlines()) < 12, said
    of_systemd = shell(
        f"journalctl UNIT=needle-rig.service _PID=1 --no-pager -o cat --since @{begun_s:.0f}"
    ).stdout
    assert "Started needle-rig.service" in of_systemd
    assert "remains running" not in of_systemd
    assert "left-over" not in of_systemd


def test_an_interface_that_is_renamed_is_missed_and_used_again_under_its_name(rig: Rig) -> None:
    pid = main_pid()
    shell("ip link set vcan0 down && ip link set vcan0 name other0 && ip link set other0 up")
    try:
        until(lambda: "no interface vcan0" in (status().get("fault") or ""), "the interface is named")
    finally:
        shell("ip link set other0 down && ip link set other0 name vcan0 && ip link set vcan0 up")
    until(lambda: status().get("fault") is None, "it works again")
    assert main_pid() == pid


def test_an_interface_that_goes_down_is_named_and_comes_back_without_a_restart(rig: Rig) -> None:
    pid = main_pid()
    shell("ip link set vcan0 down")
    try:
        until(lambda: "vcan0 is down" in (status().get("fault") or ""), "the interface is named")
    finally:
        shell("ip link set vcan0 up")
    until(lambda: status().get("fault") is None, "it works again")
    assert main_pid() == pid


def test_an_interface_that_is_deleted_and_made_anew_is_used_again(rig: Rig) -> None:
    pid = main_pid()
    before = len(journal().splitlines())
    shell("ip link del vcan0")
    try:
        until(lambda: "no interface vcan0" in (status().get("fault") or ""), "the interface is named")
        time.sleep(10)
    finally:
        shell("ip link add vcan0 type vcan && ip link set vcan0 up")
    until(lambda: status().get("fault") is None, "it works again", 60)
    assert main_pid() == pid
    assert len(journal().splitlines()) - before < 8, journal()


def test_a_killed_daemon_starts_again_tells_it_and_its_run_is_closed(rig: Rig) -> None:
    process = started_run()
    begun(process)
    shell(f"kill -KILL {main_pid()}")
    assert process.wait(60) == 3
    process.communicate()
    until(active, "it starts again", 60)
    until(lambda: "killed (signal KILL)" in (status().get("before") or ""), "how it ended is told")
    until(cut_run_told, "the run that was cut off is told", 60)
    last = json.loads(needle_rig("runs", "--json").stdout)[-1]
    assert last["status"] == "cut off"
    assert not list(RUNS.glob("*.journal"))


def test_a_daemon_that_hangs_is_ended_by_its_watchdog(rig: Rig) -> None:
    pid = main_pid()
    shell(f"kill -STOP {pid}")
    until(lambda: main_pid() not in (0, pid) and active(), "it starts again", 60)
    until(lambda: "watchdog" in (status().get("before") or ""), "the watchdog is told")


def test_a_stop_in_mid_run_ends_the_run_in_order(rig: Rig) -> None:
    process = started_run()
    begun(process)
    shell("systemctl stop needle-rig", timeout_s=60)
    assert process.wait(60) == 4
    process.communicate()
    shell("systemctl start needle-rig", timeout_s=120)
    last = json.loads(needle_rig("runs", "--json").stdout)[-1]
    assert (last["status"], last["complete"]) == ("aborted", True)
    until(lambda: "told to end" in (status().get("before") or ""), "how it ended is told")


def test_a_rig_file_that_cannot_be_used_is_told_with_its_line_and_not_tried_again(rig: Rig) -> None:
    good = RIG_FILE.read_text()
    hook, told_whom = RIG_FILE.with_name("on-failure"), RUNS / "failed"
    hook.write_text(f'#!/bin/sh\necho "$1: $(journalctl -u "$1" -n 20 -o cat)" > {told_whom}\n')
    hook.chmod(0o755)
    line = 1 + [each.partition(":")[0] for each in good.splitlines()].index("tick_hz")
    shell("systemctl stop needle-rig")
    RIG_FILE.write_text(re.sub("tick_hz: .*", "tick_hz: fast", good))
    try:
        shell("systemctl start needle-rig", check=False)
        until(lambda: "failed" in shell("systemctl is-failed needle-rig", check=False).stdout, "it fails")
        assert "tick_hz" in journal()
        until(lambda: told_whom.exists() and "tick_hz" in told_whom.read_text(), "its hook tells it")
        assert told_whom.read_text().startswith("needle-rig.service: ")
        done = needle_rig("status")
        assert done.returncode == 3
        for told in (done.stderr, needle_rig("check").stdout):
            assert f"{RIG_FILE}:{line}:" in told
            assert "mend it, then: sudo systemctl restart needle-rig" in told
        RIG_FILE.write_text(good)
        looked = needle_rig("check")
        assert looked.returncode == 1
        assert "fail  daemon: a rig is set up here" in looked.stdout
        assert "real time" not in looked.stdout  # it would be of a daemon of its own
    finally:
        RIG_FILE.write_text(good)
        hook.unlink()
        told_whom.unlink(missing_ok=True)
    shell("systemctl restart needle-rig", timeout_s=120)


def test_another_rig_of_the_same_computer_comes_and_goes_and_the_first_does_not_notice(rig: Rig) -> None:
    pid = main_pid()
    left = "env NEEDLE_RIG_AT=left"
    set_up = f"{left} {PROGRAM} install-service --name left --can vcan7 --hall {PORTS}/left"
    shell(f"{set_up} --member tech", timeout_s=180)
    until(lambda: "since:" in of_left("status"), "it runs", START_S)
    until(lambda: "fault" in of_left("status"), "it misses its rig")
    told = of_left("status")
    assert re.search(r"(?m)^rig: +left, .*/run/needle-rig@left/daemon.sock$", told), told
    assert f"{PORTS}/left" in told  # what it misses is its own
    assert status()["fault"] is None
    assert "vcan7" in shell("ip -brief link show type vcan").stdout
    removed = shell(f"{left} {PROGRAM} install-service --remove", timeout_s=120).stdout
    assert "Account, command and rules stay, as needle-rig.service uses them" in removed
    assert shell("systemctl cat needle-rig@left", check=False).returncode != 0
    assert not Path("/run/needle-rig@left").exists()
    shell("ip link del vcan7")
    assert (main_pid(), status()["fault"]) == (pid, None)
    assert needle_rig("status").returncode == 0


def of_left(*arguments: str) -> str:
    """What the command says of the rig `left`."""
    command = as_user("tech", "env", "NEEDLE_RIG_AT=left", PROGRAM, *arguments)
    done = subprocess.run(command, cwd="/home/tech", capture_output=True, text=True, timeout=180)
    return done.stdout + done.stderr


def test_term_is_obeyed_while_the_first_start_compiles(rig: Rig, tmp_path: Path) -> None:
    environment = f"NUMBA_CACHE_DIR={tmp_path} XDG_RUNTIME_DIR={tmp_path}"
    process = subprocess.Popen(
        f"exec env {environment} {PROGRAM} daemon --config {BENCH} --out {tmp_path}",
        shell=True,
        stderr=subprocess.PIPE,
    )
    time.sleep(8)
    process.send_signal(signal.SIGTERM)
    begun_s = time.monotonic()
    process.communicate(timeout=60)
    assert time.monotonic() - begun_s < 5


def test_check_finds_nothing_that_fails_and_shows_directions_by_a_move(rig: Rig) -> None:
    done = needle_rig("check", "--move", "20", "--json")
    told = json.loads(done.stdout)
    failed = [finding for finding in told["findings"] if finding["verdict"] == "fail"]
    assert (done.returncode, failed) == (0, []), done.stdout
    names = {finding["name"] for finding in told["findings"]}
    assert {"CAN", "bus load", "torque node", "hall node", "drive node", "encoder", "torque cell"} <= names
    assert told["simulated"] is False


def test_check_names_what_fails_when_the_rig_is_off(rig: Rig) -> None:
    rig.switch_off()
    until(lambda: status().get("fault") is not None, "a fault is told")
    done = needle_rig("check")
    assert done.returncode == 1
    assert "fail  torque node: " in done.stdout
    assert "fail  Hall port: there is no /run/bench/hall" in done.stdout
