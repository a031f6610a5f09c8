"""Measures how much of a core the daemon and its simulated rig take, beside another commit in the same run.

processor_time --against REF [--seconds 20] [--rounds 3]

At rest and in a run, at 200 and 1000 ticks a second. The trees are asked in turn, each with a daemon of its
own; a share is the processor time of a process by /proc over the time that passed, the median of the rounds.
Beside a busy neighbour both trees take more: caches are cold at every tick.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from campaigns import ROOT
from campaigns.rig.daemons import wait_for
from needle_rig.service.client import DaemonClient

RATES_HZ = (200, 1000)
CALM_S = 3.0
SETTLE_S = 8.0
"""After each motion of a run: it must not end while it is measured."""
Shares = dict[tuple[int, str, str], float]


@contextmanager
def tree_of(reference: str, folder: Path) -> Iterator[Path]:
    """The files of another commit."""
    place = folder / "other"
    subprocess.run(
        ["git", "-C", ROOT, "worktree", "add", "--quiet", "--detach", place, reference], check=True
    )
    try:
        yield place
    finally:
        subprocess.run(["git", "-C", ROOT, "worktree", "remove", "--force", place], check=True)


@contextmanager
def daemon(tree: Path, rate_hz: int, folder: Path) -> Iterator[tuple[DaemonClient, dict[str, int]]]:
    """A daemon of this tree, and its processes by name."""
    rig = folder / f"rig_{rate_hz}.yaml"
    rig.write_text((tree / "config/rig.yaml").read_text().replace("tick_hz: 200", f"tick_hz: {rate_hz}"))
    socket = folder / "d.sock"
    command = [sys.executable, "-m", "needle_rig", "daemon", "--config", str(rig), "--socket", str(socket)]
    command += ["--out", str(folder / "runs")]
    folders = {"XDG_RUNTIME_DIR": str(folder), "TMPDIR": str(folder), "PYTHONPATH": str(tree)}
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(command, env=os.environ | folders, stderr=log, cwd=folder)
        try:
            yield wait_for(socket), {"daemon": process.pid, "bench": bench_of(process.pid)}
        finally:
            process.terminate()
            process.wait(60.0)


def bench_of(pid: int) -> int:
    """Its child that simulates the rig."""
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            if "needle_rig.simulation.bench" in Path(f"/proc/{child}/cmdline").read_text():
                return child
    raise SystemExit("the daemon has no simulated rig")


def used_s(pid: int) -> float:
    """Processor time of a process so far, its threads included."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def shares(tree: Path, rate_hz: int, seconds: float) -> Shares:
    """In per cent of a core, by (ticks a second, when, process)."""
    found: Shares = {}
    with (
        tempfile.TemporaryDirectory(prefix="nr-") as name,
        daemon(tree, rate_hz, Path(name)) as (client, pids),
    ):
        time.sleep(CALM_S)
        for when in ("at rest", "in a run"):
            if when == "in a run":
                client.compensate({"target_deg": 45.0, "strategy": "reed2008", "settle_s": SETTLE_S})
            begun_s, before = time.monotonic(), {name: used_s(pid) for name, pid in pids.items()}
            time.sleep(seconds)
            passed_s = time.monotonic() - begun_s
            for process, pid in pids.items():
                found[rate_hz, when, process] = (used_s(pid) - before[process]) / passed_s * 100.0
        state = client.state()
        if state["phase"] not in ("rest", "moving", "settling", "measuring"):
            raise SystemExit(f"the run ended while it was measured: {state['phase']}: {state['fault']}")
    return found


def main() -> None:
    """Measure both trees and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", required=True, metavar="REF")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    found: dict[str, dict[tuple[int, str, str], list[float]]] = {"before": defaultdict(list)}
    found["now"] = defaultdict(list)
    with (
        tempfile.TemporaryDirectory() as name,
        tree_of(options.against, Path(name)) as other,
    ):
        for _ in range(options.rounds):
            for rate_hz in RATES_HZ:
                for which, tree in (("before", other), ("now", ROOT)):
                    for key, share in shares(tree, rate_hz, options.seconds).items():
                        found[which][key].append(share)
    load = os.getloadavg()[1]
    print(f"In % of a core; before: {options.against}. Load of the machine meanwhile: {load:.1f}.\n")
    print("| ticks/s | when | process | before | now | now / before |\n|---|---|---|---|---|---|")
    for (rate_hz, when, process), before in found["before"].items():
        now = found["now"][rate_hz, when, process]
        ratio = statistics.median(b / a for a, b in zip(before, now, strict=True))
        told = f"{statistics.median(before):.1f} | {statistics.median(now):.1f} | {ratio:.2f}"
        print(f"| {rate_hz} | {when} | {process} | {told} |")


if __name__ == "__main__":
    main()
