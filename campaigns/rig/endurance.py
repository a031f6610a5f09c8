"""Runs one daemon for long and looks whether anything grows.

It compensates in virtual time (`--where mode=fast`), or on the simulated rig in real time (bench), or stands
(idle). At ten points memory, descriptors, threads, children and files are counted. Exit code 1 when a run is
not whole, when something grew, or when something is left behind.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from pathlib import Path

from campaigns.rig.daemons import wait_for
from campaigns.run import Campaign, Row, answered, markdown
from needle_rig.errors import NeedleRigError
from needle_rig.recording import RunFile
from needle_rig.service.api.documents import Ended
from needle_rig.service.client import DaemonClient

POINTS = 10
GROWTH_KB_A_POINT = 300
"""Of resident memory, from the third point on: what 100 runs of a leak of 3 kB each would take."""


def look(done: str, pid: int, runs: Path, folder: Path) -> Row:
    """What the daemon and its children take at one instant."""
    pids = [pid, *descendants(pid)]
    status = [Path(f"/proc/{each}/status").read_text() for each in pids]

    def summed(name: str) -> int:
        return sum(int(text.split(f"{name}:")[1].split()[0]) for text in status)

    return {
        "done": done,
        "memory kB": summed("VmRSS"),
        "descriptors": sum(len(os.listdir(f"/proc/{each}/fd")) for each in pids),
        "threads": summed("Threads"),
        "children": len(pids) - 1,
        "other files": sum(1 for path in folder.rglob("*") if runs not in path.parents),
    }


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
    raise RuntimeError(f"the daemon ended in run {number}")


def plan(given: Namespace) -> list[Row]:
    return [
        {"mode": "fast", "runs": 10 * given.size},
        {"mode": "bench", "runs": max(POINTS, given.size)},
        {"mode": "idle", "runs": 0, "minutes": 0.6 * given.size},
    ]


def ask(task: Row, _: Namespace) -> Row:
    """What one daemon takes at each point, what grew from the fourth on, and what is left."""
    fast, runs, minutes = task["mode"] == "fast", task["runs"], task.get("minutes", 0.0)
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder / "run"), "TMPDIR": str(folder / "tmp")}
        (folder / "tmp").mkdir()
        (folder / "run").mkdir(mode=0o700)
        command = [sys.executable, "-m", "needle_rig", "daemon", "--out", str(folder / "runs")]
        socket = folder / "daemon.sock"
        command += ["--socket", str(socket), *(["--fast"] if fast else [])]
        with (
            (folder / "log").open("w") as log,
            subprocess.Popen(command, env=environment, stderr=log) as daemon,
        ):
            try:
                client = wait_for(socket)
                points = [look("0", daemon.pid, folder / "runs", folder)]
                for step in range(1, POINTS + 1):
                    time.sleep(minutes * 60.0 / POINTS)
                    for number in range((step - 1) * runs // POINTS, step * runs // POINTS):
                        wrong += judged(compensate(client, number, 0.1 if fast else 0.2))
                    done = f"{step * runs // POINTS} runs" if runs else f"{minutes * step / POINTS:g} min"
                    points.append(look(done, daemon.pid, folder / "runs", folder))
                ticks = client.state()["ticks"]
            finally:
                daemon.terminate()
                daemon.wait(60.0)
        left = [*map(str, (folder / "tmp").iterdir()), *map(str, (folder / "run").rglob("*.sock"))]
    first, last = points[3], points[-1]
    limits = {name: GROWTH_KB_A_POINT if name == "memory kB" else 0 for name in first if name != "done"}
    grown = [name for name, most in limits.items() if last[name] - first[name] > most * (POINTS - 2)]
    return {"points": points, "ticks": ticks, "wrong": wrong, "grown": grown, "left": left}


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


def table(rows: list[Row], _: Namespace) -> str:
    """The figures as Markdown."""
    found = answered(rows)
    heads = ["daemon", *(found[0]["points"][0] if found else ())]
    points = ([row["mode"], *point.values()] for row in found for point in row["points"])
    lines = [markdown(heads, points), ""]
    for row in found:
        lines.append(f"- {row['mode']}: ticks {json.dumps(row['ticks'])}")
        lines.append(f"- {row['mode']}: {len(row['wrong'])} runs are not whole {row['wrong'][:10] or ''}")
        grown, left = (", ".join(row[name]) or "nothing" for name in ("grown", "left"))
        lines.append(f"- {row['mode']}: grown {grown}, left behind {left}")
    return "\n".join(lines)


def failed(rows: list[Row]) -> bool:
    return any(row["wrong"] or row["grown"] or row["left"] for row in answered(rows))


SIZE = "percent of 1,000 runs in virtual time, of 100 on the bench, of an idle hour (100)"
CAMPAIGN = Campaign(__doc__, plan, ask, table, 100, SIZE, failed=failed, jobs=1)
