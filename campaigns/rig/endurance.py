"""Runs one daemon for long and looks whether anything grows.

`endurance fast [--runs 1000]` compensates in virtual time, `bench [--runs 100]` on the simulated rig
in real time, `idle [--minutes 60]` lets it stand. Each prints memory, descriptors, threads, children and
files at ten points, and prints the table. Exit code 1 when a run is not whole, or when
something grew.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import astuple, dataclass
from pathlib import Path

from campaigns.rig.daemons import wait_for
from needle_rig.errors import NeedleRigError
from needle_rig.recording import RunFile
from needle_rig.service.api.documents import Ended, Ticks
from needle_rig.service.client import DaemonClient

POINTS = 10
GROWTH_KB_A_POINT = 300
"""Of resident memory, from the third point on: what 100 runs of a leak of 3 kB each would take."""


@dataclass(frozen=True)
class Point:
    """The daemon's processes at one instant."""

    done: str
    memory_kb: int
    descriptors: int
    threads: int
    children: int
    files: int


def look(done: str, pid: int, runs: Path, folder: Path) -> Point:
    """Sums over the daemon and its children."""
    pids = [pid, *descendants(pid)]
    status = [Path(f"/proc/{each}/status").read_text() for each in pids]

    def field(text: str, name: str) -> int:
        return int(text.split(f"{name}:")[1].split()[0])

    return Point(
        done,
        sum(field(text, "VmRSS") for text in status),
        sum(len(os.listdir(f"/proc/{each}/fd")) for each in pids),
        sum(field(text, "Threads") for text in status),
        len(pids) - 1,
        sum(1 for path in folder.rglob("*") if runs not in path.parents),
    )


def descendants(pid: int) -> list[int]:
    """Children, their children, and so on."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            found += [child, *descendants(child)]
    return found


def compensate(client: DaemonClient, number: int, settle_s: float) -> Ended:
    """One run to its end."""
    with client.stream() as documents:
        next(documents)
        run = client.compensate(
            {"target_deg": (45.0, -45.0)[number % 2], "strategy": "reed2008", "settle_s": settle_s}
        )["run"]
        for document in documents:
            if document["type"] == "ended" and document["result"]["run"] == run:
                return document
    raise SystemExit(f"the daemon ended in run {number}")


def main() -> int:
    """Run the campaign that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("fast", "bench", "idle"))
    parser.add_argument("--runs", type=int)
    parser.add_argument("--minutes", type=float, default=60.0)
    options = parser.parse_args()
    runs = options.runs or {"fast": 1000, "bench": 100, "idle": 0}[options.what]
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder / "run"), "TMPDIR": str(folder / "tmp")}
        (folder / "tmp").mkdir()
        (folder / "run").mkdir(mode=0o700)
        command = [sys.executable, "-m", "needle_rig", "daemon", "--out", str(folder / "runs")]
        socket = folder / "daemon.sock"
        command += ["--socket", str(socket), *(["--fast"] if options.what == "fast" else [])]
        with (
            (folder / "log").open("w") as log,
            subprocess.Popen(command, env=environment, stderr=log) as daemon,
        ):
            try:
                client = wait_for(socket)
                points = [look("0", daemon.pid, folder / "runs", folder)]
                for step in range(1, POINTS + 1):
                    if options.what == "idle":
                        time.sleep(options.minutes * 60.0 / POINTS)
                    for number in range((step - 1) * runs // POINTS, step * runs // POINTS):
                        ended = compensate(client, number, 0.1 if options.what == "fast" else 0.2)
                        wrong += judged(ended)
                    done = (
                        f"{options.minutes * step / POINTS:g} min" if not runs else str(step * runs // POINTS)
                    )
                    points.append(look(done, daemon.pid, folder / "runs", folder))
                    print(*astuple(points[-1]), sep="\t", flush=True)
                ticks = client.state()["ticks"]
            finally:
                daemon.terminate()
                daemon.wait(60.0)
        left = [str(path) for path in (folder / "tmp").iterdir()] + [
            str(p) for p in (folder / "run").rglob("*.sock")
        ]
    settled = points[3:]
    grown = [
        name
        for name, limit in (
            ("memory_kb", GROWTH_KB_A_POINT),
            ("descriptors", 0),
            ("threads", 0),
            ("children", 0),
            ("files", 0),
        )
        if getattr(settled[-1], name) - getattr(settled[0], name) > limit * len(settled)
    ]
    print(table(points, ticks, wrong, grown, left))
    return bool(wrong or grown or left)


def judged(ended: Ended) -> list[str]:
    """What is wrong with a run that ended, and its file."""
    run, status = ended["result"]["run"], ended["result"]["status"]
    if status not in ("aligned", "not_aligned"):
        return [f"{run}: {status}: {ended['text']}"]
    try:
        file = RunFile(run)
        whole = file.complete and len(file.table("ticks")) > 0
    except NeedleRigError as error:
        return [f"{run}: {error}"]
    Path(run).unlink()
    return [] if whole else [f"{run}: not whole"]


def table(points: list[Point], ticks: Ticks, wrong: list[str], grown: list[str], left: list[str]) -> str:
    """The figures as Markdown."""
    lines = [
        "| done | memory kB | descriptors | threads | children | other files |",
        "|---|---|---|---|---|---|",
    ]
    lines += ["| " + " | ".join(map(str, astuple(point))) + " |" for point in points]
    lines += ["", f"ticks: {json.dumps(ticks)}", f"runs that are not whole: {len(wrong)}", *wrong[:10]]
    lines += [f"grown: {', '.join(grown) or 'nothing'}", f"left behind: {', '.join(left) or 'nothing'}", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
