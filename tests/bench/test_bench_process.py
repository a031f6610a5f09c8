"""The bench as a process: how it starts, refuses, obeys and ends."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.errors import BadInput, RigFault
from needle_rig.simulation.bench import process as bench_module
from needle_rig.simulation.bench.process import Bench, needs_bench

COMMAND = [sys.executable, "-m", "needle_rig.simulation.bench"]


def gone(pid_fd: int, timeout_s: float) -> bool:
    return bool(select.select([pid_fd], [], [], timeout_s)[0])


def test_a_config_that_says_auto_gets_the_ports(bench: Bench) -> None:
    config = load_rig_config()
    assert needs_bench(config)
    ready = bench.configured(config)
    assert not needs_bench(ready)
    assert (ready.links.can.channel, ready.links.hall_port) == (bench.ports["can"], bench.ports["hall"])
    named = bench.configured(load_rig_config(None, {"links.hall.port": "/dev/ttyUSB7"}))
    assert named.links.hall_port == "/dev/ttyUSB7"


def test_it_says_how_it_goes(bench: Bench) -> None:
    bench.tell("status")
    said = bench.wait_for(lambda said: "base_deg" in said, 10)
    assert said["faults"] == {}
    bench.harm("torque", "freeze")
    bench.tell("status")
    assert bench.wait_for(lambda said: "base_deg" in said, 10)["faults"] == {"torque": "freeze"}


@pytest.mark.parametrize("line", ["drive delay soon", "drive delay -1", "hall delay 1001", "can delay nan"])
def test_a_delay_that_it_cannot_keep_is_refused_with_its_range(bench: Bench, line: str) -> None:
    bench.tell(line)
    said = bench.wait_for(lambda said: "error" in said, 10)
    link, _, amount = line.split()
    assert said["error"] == f"{link} delay '{amount}': give milliseconds, 0 to 1000"


@pytest.mark.parametrize("line", ["torque explode", "elbow freeze", "torque", "no such thing at all"])
def test_a_line_that_it_does_not_know_is_answered_with_the_choices(bench: Bench, line: str) -> None:
    bench.tell(line)
    said = bench.wait_for(lambda said: "error" in said, 10)
    assert line in said["error"]
    assert "unplug|silence|garble|freeze|fade|restore" in said["error"]


def test_time_passes_in_the_plant_as_on_the_clock(bench: Bench) -> None:
    ends = []
    for _ in range(2):
        bench.tell("status")
        ends.append(bench.wait_for(lambda said: "base_deg" in said, 10))
        bench.heard(0.5)
    passed_s = ends[1]["time_s"] - ends[0]["time_s"]
    missed_s = ends[1]["behind_s"] - ends[0]["behind_s"]
    assert ends[1]["plant_s"] - ends[0]["plant_s"] == pytest.approx(passed_s - missed_s, abs=0.06)


@pytest.mark.parametrize(
    ("away_s", "pauses", "left_s"), [(0.15, 1, 0.0), (0.2, 2, 0.0), (0.45, 1, 0.0), (0.7, 1, 0.7)]
)
def test_pauses_of_the_machine_of_up_to_half_a_second_are_made_up_for(
    bench: Bench, away_s: float, pauses: int, left_s: float
) -> None:
    def behind_s() -> float:
        bench.tell("status")
        return float(bench.wait_for(lambda said: "base_deg" in said, 10)["behind_s"])

    before_s = behind_s()
    while bench.heard(0.3) is not None or behind_s() != before_s:
        before_s = behind_s()  # it still makes up for a pause before this test
    for _ in range(pauses):
        os.kill(bench.pid, signal.SIGSTOP)
        select.select([], [], [], away_s)
        os.kill(bench.pid, signal.SIGCONT)
        late = bench.wait_for(lambda said: said.get("event") == "late", 10)
        assert late["late_s"] == pytest.approx(away_s, abs=0.01)
    assert behind_s() - before_s == pytest.approx(pauses * away_s, abs=0.02)
    assert bench.heard(3.0) is None
    assert behind_s() - before_s == pytest.approx(left_s, abs=0.01)


def test_a_wrong_parameter_set_is_refused_as_if_in_this_process() -> None:
    with pytest.raises(BadInput, match="no_such_needle"):
        bench_module.start(load_rig_config(None, {"simulation.parameters": "no_such_needle"}))


def test_a_missing_config_is_one_line_and_exit_2() -> None:
    done = subprocess.run([*COMMAND, "--config", "no/such.yaml"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "no/such.yaml" in json.loads(done.stdout)["error"]
    assert done.stderr == ""


def test_it_dies_with_its_parent_however_that_dies() -> None:
    script = (
        "import time\nfrom needle_rig.config.loader import load_rig_config\n"
        "from needle_rig.simulation.bench.process import start\n"
        "b = start(load_rig_config())\nprint(b.pid, flush=True)\nb.heard(600)\nb.heard(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        pid_fd = os.pidfd_open(int(parent.stdout.readline()))
        assert not gone(pid_fd, 0.0)
        parent.kill()
        assert gone(pid_fd, 10.0)
        os.close(pid_fd)


def test_it_ends_on_request_and_takes_its_ports_along(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [*COMMAND, "--keep", "--ports", str(tmp_path)], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    ports = json.loads(process.stdout.readline())
    assert Path(ports["can"]).is_char_device()
    assert Path(ports["hall"]).is_char_device()
    process.send_signal(signal.SIGTERM)
    assert process.wait(10) == 0
    process.stdout.close()
    assert list(tmp_path.iterdir()) == []


def test_a_bench_that_was_killed_is_a_fault_in_words() -> None:
    bench = bench_module.start(load_rig_config())
    os.kill(bench.pid, signal.SIGKILL)
    with pytest.raises(RigFault, match="the simulated rig ended"):
        bench.wait_for(lambda said: False, 10)
    started_s = time.monotonic()
    bench.close()
    bench.close()
    assert time.monotonic() - started_s < 2.0
