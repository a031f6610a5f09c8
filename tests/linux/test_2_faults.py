"""A rig in use: its bus is missing, flooded or spoken on by others, its disk is full, its drive another."""

from __future__ import annotations

import contextlib
import json
import pickle
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from tests.linux.conftest import (
    MOVE,
    PORTS,
    PROGRAM,
    RIG_FILE,
    RUNS,
    Rig,
    active,
    at_rest,
    begun,
    journal,
    main_pid,
    needle_rig,
    order,
    outcome,
    shell,
    started_run,
    status,
    until,
)

pytestmark = pytest.mark.linux

FOREIGN = [
    can.Message(arbitration_id=0x7A0, data=b"12345678", is_extended_id=False),
    can.Message(arbitration_id=0x7A1, is_extended_id=False),
    can.Message(arbitration_id=0x101, data=b"1234567", is_extended_id=False),
    can.Message(arbitration_id=0x101, data=b"\xff" * 8, is_extended_id=False),
    can.Message(arbitration_id=0x201, data=b"\x00" * 8, is_extended_id=False),
    can.Message(arbitration_id=0x101, is_remote_frame=True, dlc=8, is_extended_id=False),
    can.Message(arbitration_id=0x1ABCDEF0, data=b"12345678", is_extended_id=True),
    can.Message(arbitration_id=0x101, data=b"12345678", is_extended_id=True),
]
"""Others' identifiers, our torque node's with a wrong length or checksum, remote and extended frames."""


def test_it_starts_without_its_bus_and_uses_the_bus_that_comes_late(rig: Rig) -> None:
    shell("systemctl stop needle-rig")
    rig.switch_off()
    shell("ip link del vcan0")
    shell("systemctl start needle-rig", timeout_s=120)
    until(lambda: "no interface vcan0" in (status().get("fault") or ""), "the interface is named")
    pid = main_pid()
    done = needle_rig(*MOVE)
    assert done.returncode == 3
    assert "vcan0" in done.stderr
    shell("ip link add vcan0 type vcan && ip link set vcan0 up")
    rig.switch_on()
    until(lambda: status().get("fault") is None and active(), "it works", 90)
    assert main_pid() == pid


def test_a_rig_is_backed_up_and_comes_back_but_not_over_a_run(rig: Rig) -> None:
    good, runs = RIG_FILE.read_text(), sorted(RUNS.glob("*.h5"))
    packed = shell(f"{PROGRAM} backup /root/rig.zip --runs").stdout
    assert f"{len(runs)} of them runs" in packed
    process = started_run()
    begun(process, "rotate")
    refused = shell(f"{PROGRAM} restore /root/rig.zip", check=False)
    assert refused.returncode == 2
    assert "this run goes on" in refused.stderr
    assert needle_rig("stop").returncode == 0
    process.communicate()
    until(lambda: not list(RUNS.glob("*.journal")), "the run is closed")
    RIG_FILE.write_text("broken")
    before = runs[0].stat()
    runs[0].unlink()
    told = shell(f"{PROGRAM} restore /root/rig.zip").stdout
    assert "1 of them runs" in told
    assert RIG_FILE.read_text() == good
    after = runs[0].stat()
    assert (after.st_uid, after.st_gid, after.st_mode, after.st_size) == (
        before.st_uid,
        before.st_gid,
        before.st_mode,
        before.st_size,
    )
    shell("systemctl restart needle-rig", timeout_s=120)


def test_a_report_holds_what_somebody_needs_who_was_not_there(rig: Rig) -> None:
    shell(f"{PROGRAM} report /root/report.zip", timeout_s=180)
    with zipfile.ZipFile("/root/report.zip") as file:
        found = {name: file.read(name) for name in file.namelist()}
    assert {"versions.txt", "unit.txt", "rig/rig.yaml"} <= found.keys()
    assert json.loads(found["status.json"])["rig"]["name"] == "guest"
    assert json.loads(found["check.json"])["verdict"] in ("ok", "warn")
    assert b"ready" in found["journal.txt"]
    assert [name for name in found if name.startswith("run/")]


def test_a_restart_in_mid_run_is_quiet_closes_the_run_and_is_ready_again(rig: Rig) -> None:
    begun_s = time.time()
    process = started_run()
    begun(process)
    shell("systemctl restart needle-rig", timeout_s=120)
    assert process.wait(60) == 4
    process.communicate()
    last = json.loads(needle_rig("runs", "--json").stdout)[-1]
    assert (last["status"], last["complete"]) == ("aborted", True)
    until(lambda: status().get("sensors") is not None, "it is ready again")
    said = shell(f"journalctl -u needle-rig --since @{begun_s:.0f} --no-pager -o cat").stdout
    assert "Started" in said  # what systemd says of the unit is among it
    assert "remains running" not in said
    assert "left-over" not in said


@contextlib.contextmanager
def sending(interface: str, messages: list[can.Message], every_s: float) -> Iterator[None]:
    """`messages` on an interface, one after the other, by another process on the same machine."""
    source = (
        "import pickle, sys, time, can\n"
        "bus = can.Bus(interface='socketcan', channel=sys.argv[1])\n"
        "messages = pickle.loads(sys.stdin.buffer.read())\n"
        "while True:\n"
        "    for message in messages:\n"
        "        bus.send(message)\n"
        "        time.sleep(float(sys.argv[2]))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", source, interface, str(every_s)], stdin=subprocess.PIPE)
    assert process.stdin is not None
    process.stdin.write(pickle.dumps(messages))
    process.stdin.close()
    time.sleep(2.0)
    assert process.poll() is None
    try:
        yield
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """A bus on which nobody listens: what is sent there costs the same time, and says nothing."""
    shell("ip link add vcan1 type vcan && ip link set vcan1 up")
    yield "vcan1"
    shell("ip link del vcan1")


def test_frames_of_others_change_nothing_that_the_same_sending_elsewhere_does_not(
    rig: Rig, elsewhere: str
) -> None:
    with sending(elsewhere, FOREIGN, 0.05):
        control = outcome()
    with sending("vcan0", FOREIGN, 0.05):
        told = outcome()
    assert (told["code"], told["status"]) == (control["code"], control["status"]), (told, control)
    assert told["code"] == 0
    lags = [result["final"]["tip_lag_deg"] for result in (told, control)]
    assert lags[0] == pytest.approx(lags[1], abs=1.0)


def test_in_a_flood_the_drive_moves_as_it_should_or_stops_and_the_same_load_elsewhere_is_told(
    rig: Rig, elsewhere: str
) -> None:
    ends = {}
    for interface in (elsewhere, "vcan0"):
        flood = subprocess.Popen(["cangen", interface, "-g", "0", "-I", "7FF", "-L", "8", "-x", "-i"])
        time.sleep(1.0)
        assert flood.poll() is None
        try:
            ends[interface] = outcome()
            still = still_after(0.5) if ends[interface]["code"] == 3 else 0.0
        finally:
            flood.kill()
            flood.wait()
        assert ends[interface]["code"] in (0, 3), ends
        assert abs(still) < 1.0, "a drive that was told to stop stands"
        until(lambda: status().get("fault") is None or rig.cleared(), "it works again", 60)


def still_after(seconds: float) -> float:
    """How far the base turns in this time, in degrees."""
    before = status()["sensors"]["base_deg"]
    time.sleep(seconds)
    return float(status()["sensors"]["base_deg"] - before)


def test_a_full_disk_ends_the_run_with_one_sentence_and_the_next_run_is_whole(rig: Rig) -> None:
    shell(f"mount -t tmpfs -o size=400k,mode=0755 none {RUNS} && chown needle-rig: {RUNS}")
    try:
        full = needle_rig("compensate", "--target", "30", "--settle", "3", "--no-picture")
        assert full.returncode == 3, full.stderr
        assert "Traceback" not in full.stdout + full.stderr + journal()
        assert "No space left on device" in full.stdout + full.stderr, full.stdout
        assert abs(still_after(0.5)) < 1.0
        shell(f"mount -o remount,size=50M {RUNS}")
        until(rig.cleared, "no fault stands")
        assert outcome()["code"] == 0
        listed = json.loads(needle_rig("runs", "--json").stdout)
        assert listed[-1]["complete"] is True
        table = needle_rig("export", "last", "--csv", "--out", "/tmp/after")
        assert table.returncode == 0, table.stderr
    finally:
        shell("systemctl stop needle-rig")
        shell(f"umount {RUNS}")
        shell("systemctl start needle-rig", timeout_s=120)


def test_a_cia_402_drive_turns_the_needle_and_stops_when_its_host_does(rig: Rig) -> None:
    good = RIG_FILE.read_text()
    units = "position_units_per_turn: 409600, velocity_units_per_rpm: 100"
    drive = f"  drive: {{device: cia402, node_id: 5, {units}}}\n"
    shell("systemctl stop needle-rig")
    rig.switch_off()
    RIG_FILE.write_text(good.replace("links:\n", "links:\n" + drive, 1))
    assert RIG_FILE.read_text() != good
    try:
        rig.switch_on(drive)
        shell("systemctl start needle-rig", timeout_s=120)
        until(lambda: status().get("fault") is None and status().get("sensors") is not None, "it runs", 90)
        until(rig.cleared, "no fault stands")
        order("home", {"by": "here", "angle_deg": 0.0, "speed_deg_s": 10.0})
        told = outcome()
        assert told["code"] == 0, (told, journal())
        assert told["motions"][0]["base_deg"] == pytest.approx(30.0, abs=0.5)
        process = started_run()
        begun(process)
        pid = main_pid()
        shell(f"kill -STOP {pid}")
        until(lambda: main_pid() not in (0, pid) and active(), "its watchdog starts it again", 60)
        process.communicate()
        until(lambda: status().get("sensors") is not None, "it is ready again")
        assert abs(still_after(0.5)) < 0.5
    finally:
        shell("systemctl stop needle-rig")
        rig.switch_off()
        RIG_FILE.write_text(good)
        shell("systemctl start needle-rig", timeout_s=120)
        rig.switch_on()
        until(lambda: status().get("fault") is None, "the rig works again", 90)


def test_an_slcan_adapter_that_slcand_makes_an_interface_of_is_used_pulled_and_used_again(rig: Rig) -> None:
    good = RIG_FILE.read_text()
    shell("systemctl stop needle-rig")
    rig.switch_off()
    RIG_FILE.write_text(good.replace("vcan0", "slcan0"))
    assert RIG_FILE.read_text() != good
    try:
        rig.switch_on(interface=None)
        attach_adapter()
        shell("systemctl start needle-rig", timeout_s=120)
        until(lambda: status().get("fault") is None and at_rest(), "it runs", 90)
        until(rig.cleared, "no fault stands")
        rig.refer()
        told = outcome()
        assert told["code"] == 0, (told, journal())
        rig.tell("can unplug")
        until(lambda: "no interface slcan0" in (status().get("fault") or ""), "the adapter is missed")
        shell("pkill slcand", check=False)
        rig.tell("can restore")
        attach_adapter()
        until(lambda: status().get("fault") is None or rig.cleared(), "it works again", 60)
    finally:
        shell("systemctl stop needle-rig; pkill slcand", check=False)
        rig.switch_off()
        RIG_FILE.write_text(good)
        shell("systemctl start needle-rig", timeout_s=120)
        rig.switch_on()
        until(lambda: status().get("fault") is None, "the rig works again", 90)


def attach_adapter() -> None:
    """As a udev rule does it with an adapter that speaks slcan."""
    until((PORTS / "can").exists, "the adapter is there")
    shell(f"modprobe slcan && slcand -o -s8 {(PORTS / 'can').resolve()} slcan0")
    until(lambda: Path("/sys/class/net/slcan0").exists(), "slcand makes the interface")
    shell("ip link set slcan0 up")


def test_runs_are_read_by_members_alone(rig: Rig) -> None:
    run = sorted(RUNS.glob("*.h5"))[-1]
    assert Path(run).stat().st_mode & 0o007 == 0
    other = needle_rig("export", "last", "--csv", "--out", "/home/guest/out", user="guest")
    assert other.returncode in (2, 3), other.stdout


def test_the_watch_looks_at_runs_in_the_service_s_own_cage(rig: Rig) -> None:
    until(lambda: "watch:" in needle_rig("status").stdout, "the watch has looked", 280)
