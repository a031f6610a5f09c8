"""What kill -9 leaves behind: daemon, private daemon, client, bench and API process, at random instants.

After each kill every process that belonged to it must end, and no folder, socket or lock may be left in the
temporary folder and beside the socket. Exit code 1 when anything is.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from argparse import Namespace
from pathlib import Path

from campaigns.run import Campaign, Row, answered, markdown

PROGRAM = [sys.executable, "-m", "needle_rig"]
MARK = "NEEDLE_RIG_KILLS_MARK"
STARTED_S = 4.0
GONE_S = 25.0
# what runs, and which of its processes is killed
KINDS = {
    "client": (["compensate", "--target", "45", "--fast", "--settle", "600", "--no-picture"], "compensate"),
    "private daemon": (
        ["compensate", "--target", "45", "--fast", "--settle", "600", "--no-picture"],
        "daemon --private",
    ),
    "daemon": (["daemon", "--fast"], "needle_rig daemon"),
    "daemon with bench": (["daemon"], "needle_rig daemon"),
    "bench": (["compensate", "--target", "45", "--settle", "600", "--no-picture"], "simulation.bench"),
    "api": (["compensate", "--target", "45", "--fast", "--settle", "600", "--no-picture"], "api_process"),
}


def processes(mark: str) -> dict[int, str]:
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() in (folder / "environ").read_bytes():
                found[int(folder.name)] = (folder / "cmdline").read_text().replace("\0", " ")
        except OSError:
            continue
    return found


def left_in(*folders: Path) -> list[str]:
    return [str(each) for folder in folders if folder.is_dir() for each in folder.iterdir()]


def one(kind: str, folder: Path, chance: random.Random) -> str:
    """What was left after one kill; empty: nothing."""
    command, victim = KINDS[kind]
    mark, temporary, runtime = uuid.uuid4().hex, folder / "t", folder / "r"
    temporary.mkdir(exist_ok=True)
    environment = {**os.environ, MARK: mark, "TMPDIR": str(temporary), "XDG_RUNTIME_DIR": str(runtime)}
    quiet = subprocess.DEVNULL
    with subprocess.Popen(
        [*PROGRAM, *command], cwd=folder, env=environment, stdin=quiet, stdout=quiet, stderr=quiet
    ) as process:
        deadline_s = time.monotonic() + GONE_S
        while not (found := [pid for pid, line in processes(mark).items() if victim in line]):
            if time.monotonic() > deadline_s or process.poll() is not None:
                break
            time.sleep(0.01)
        time.sleep(chance.uniform(0, STARTED_S))
        for pid in found:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        if kind == "api":  # it is replaced, and goes with its daemon
            time.sleep(chance.uniform(0, 1.5))
            process.send_signal(signal.SIGTERM)
    deadline_s = time.monotonic() + GONE_S
    while time.monotonic() < deadline_s:
        alive, files = processes(mark), left_in(temporary, runtime / "needle-rig")
        if not alive and not files:
            return ""
        time.sleep(0.05)
    for pid in alive:
        os.kill(pid, signal.SIGKILL)
    return f"{sorted(alive.values())} {files}"


def plan(given: Namespace) -> list[Row]:
    kinds = list(KINDS)
    return [{"kind": kinds[k % len(kinds)], "seed": given.first_seed + k} for k in range(given.size)]


def ask(task: Row, _: Namespace) -> Row:
    with tempfile.TemporaryDirectory(prefix="kills-", ignore_cleanup_errors=True) as folder:
        return {"left": one(task["kind"], Path(folder), random.Random(task["seed"]))}


def table(rows: list[Row], _: Namespace) -> str:
    """Kills and what they left, by kind."""
    left = {kind: [row["left"] for row in answered(rows) if row["kind"] == kind] for kind in KINDS}
    lines = ((kind, len(of), "; ".join(filter(None, of)) or 0) for kind, of in left.items())
    return markdown(("killed", "kills", "left something behind"), lines)


def failed(rows: list[Row]) -> bool:
    return any(row["left"] for row in answered(rows))


CAMPAIGN = Campaign(__doc__, plan, ask, table, 100, "kills (100)", failed=failed)
