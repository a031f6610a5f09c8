"""The power goes off in mid-run: one boot in which it does, and the next."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest

from tests.linux.conftest import (
    BOOT_MARK,
    RUNS,
    Rig,
    active,
    begun,
    cut_run_told,
    needle_rig,
    outcome,
    shell,
    started_run,
    until,
)

pytestmark = pytest.mark.linux

LOST_S = 2.5
"""Of a run at most: the recorder writes its journal to the disk twice a second, for which one busy emulated
core may need some times as long. What nobody wrote to the disk the kernel writes after five seconds."""
CUT_AFTER_S = 6.0


@pytest.mark.skipif(BOOT_MARK.exists(), reason="the power was cut already")
def test_the_power_is_cut_in_mid_run(rig: Rig) -> None:
    process = started_run("--settle", "3")
    begun(process)
    time.sleep(CUT_AFTER_S)
    assert process.poll() is None
    cut()
    raise AssertionError("the machine still runs")


def cut() -> None:
    name = max(RUNS.glob("*.journal"), key=lambda path: path.stat().st_mtime).stem
    descriptor = os.open(BOOT_MARK, os.O_WRONLY | os.O_CREAT)
    os.write(descriptor, json.dumps({"run": name, "time_s": time.time()}).encode())
    os.fsync(descriptor)
    Path("/proc/sys/kernel/sysrq").write_text("1")
    Path("/proc/sysrq-trigger").write_text("b")  # at once: nothing is written to the disk any more
    time.sleep(30)


@pytest.mark.skipif(not BOOT_MARK.exists(), reason="the power was not cut yet")
def test_after_the_power_cut_the_service_is_back_and_little_of_the_run_is_lost(power_back: Rig) -> None:
    mark = json.loads(BOOT_MARK.read_text())
    until(active, "the service starts with the machine", 120)
    until(cut_run_told, "the cut run is told", 120)
    last = [run for run in json.loads(needle_rig("runs", "--json").stdout) if mark["run"] in run["path"]]
    assert [run["status"] for run in last] == ["cut off"]
    assert not list(RUNS.glob("*.journal"))
    out = Path("/tmp/cut")
    exported = needle_rig("export", last[0]["path"], "--csv", "--out", str(out), user="tech")
    assert exported.returncode == 0, exported.stderr
    rows = (out / "ticks.csv").read_text().splitlines()
    seen_s = float(rows[-1].split(",")[0]) - float(rows[1].split(",")[0])
    begun_utc_s = float(shell(f"date -d '{last[0]['started_utc']}' +%s.%N").stdout)
    assert mark["time_s"] - begun_utc_s - seen_s < LOST_S
    assert outcome()["code"] == 0
