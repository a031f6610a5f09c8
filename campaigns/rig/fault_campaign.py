"""Breaks the simulated rig in real time, behind its ports, at random instants of a running daemon.

Each fault of `KINDS` meets a daemon with its drivers on a bench with the firmware's nodes, while the base
turns to and fro. Looked at: how long until the drive stopped, what the fault was called, whether the run's
file is whole, and whether the documented step brings the rig back. Exit code 1 when one of them failed.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path

from campaigns.rig.daemons import wait_for
from campaigns.run import Campaign, Row, answered, markdown
from needle_rig.config.files import find_config_file
from needle_rig.config.loader import load_rig_config
from needle_rig.control.compensation import ACTIVE
from needle_rig.errors import NeedleRigError
from needle_rig.recording import RunFile
from needle_rig.service.api.documents import State
from needle_rig.service.client import DaemonClient
from needle_rig.simulation.bench.process import Bench, start

AGE_LIMIT_MS = 250.0
LINK_BOUND_MS = AGE_LIMIT_MS + 50.0
"""A dead link: the age limit, and ten ticks for bus and host."""
MOTION_BOUND_MS = 1500.0
"""What the motor does shows when it is asked to turn: after the longest rest of the sequence."""
TWIST_BOUND_MS = 6000.0
"""A shaft that is not felt shows in its twist: within two motions."""
LINKS = [
    *(
        f"{link} {how}"
        for link in ("torque", "drive", "hall", "can")
        for how in ("unplug", "silence", "garble", "freeze")
    ),
    "hall fade",
]
MOTION = [
    "encoder stick",
    "encoder reverse",
    "motor short",
    "motor dead",
    "motor reverse",
    "drive reset",
    "estop press",
]
TWIST = ["encoder halve", "coupling slip", "torque-cell dead", "torque-cell stick"]
KINDS = {
    **dict.fromkeys(LINKS, LINK_BOUND_MS),
    **dict.fromkeys(MOTION, MOTION_BOUND_MS),
    **dict.fromkeys(TWIST, TWIST_BOUND_MS),
}
ORDER = {"strategy": "protocol", "settle_s": 0.2, "target_deg": 0.0, "speed_deg_s": 45.0}
STEPS_DEG = (45.0, -20.0, 30.0, 0.0)
LATEST_S = 3.0
END_S = 20.0


@dataclass
class Trial:
    """One fault at one instant. `stopped_ms` is None when the sequence had ended, or went on to its end."""

    kind: str
    stopped_ms: float | None
    name: str
    whole: bool
    back: bool
    note: str = ""


@dataclass
class Stand:
    """A bench, a daemon on it, and what they have said."""

    folder: Path
    seed: int
    bench: Bench = field(init=False)
    daemon: subprocess.Popen[bytes] = field(init=False)
    client: DaemonClient = field(init=False)

    def __post_init__(self) -> None:
        settings = {
            "simulation.nodes": "firmware",
            "simulation.seed": self.seed,
            "sequence.settle_s": 0.2,
            "sequence.torque_window_s": 0.1,
        }
        config = load_rig_config(None, settings)
        self.bench = start(config, 300.0)
        text = find_config_file("rig.yaml").read_text()
        for before, after in (
            ("channel: auto", f"channel: {self.bench.ports['can']}"),
            ("port: auto", f"port: {self.bench.ports['hall']}"),
            ("settle_s: 3.0", "settle_s: 0.2"),
            ("torque_window_s: 0.5", "torque_window_s: 0.1"),
        ):
            assert before in text, before
            text = text.replace(before, after)
        (self.folder / "rig.yaml").write_text(text)
        self.daemon = subprocess.Popen(
            [sys.executable, "-m", "needle_rig", "daemon", "--config", str(self.folder / "rig.yaml"),
             "--socket", str(self.folder / "daemon.sock"), "--out", str(self.folder / "runs")],
            stderr=(self.folder / "log").open("w"), env={**os.environ, "XDG_RUNTIME_DIR": str(self.folder)},
        )  # fmt: skip
        self.client = wait_for(self.folder / "daemon.sock", self.folder / "log")

    def close(self) -> None:
        """End both."""
        self.daemon.terminate()
        self.daemon.wait(30.0)
        self.bench.close()

    def until_over(self) -> State:
        """The state once nothing is active and the run's file is closed."""
        deadline_s = time.monotonic() + END_S
        while time.monotonic() < deadline_s:
            state = self.client.state()
            if (
                state["run"] is None
                and not state["moving"]
                and state["phase"] not in [phase.value for phase in ACTIVE]
            ):
                return state
            time.sleep(0.02)
        raise RuntimeError(f"the run does not end: {json.dumps(self.client.state())[:400]}")

    def stopped_s(self, since_s: float) -> float | None:
        """When the drive left RUNNING after `since_s`, on the monotonic clock; None if not by now."""
        now_s = time.monotonic()
        while (said := self.bench.heard(0.05)) is not None and said.get("time_s", 0.0) < now_s:
            if said.get("event") == "drive" and said["time_s"] >= since_s and said["state"] != "running":
                return float(said["time_s"])
        return None


def trial(stand: Stand, kind: str, delay_s: float) -> Trial:
    """Break it `delay_s` into a run, look, mend, and bring it back as the manual says."""
    client, (place, how) = stand.client, kind.split()
    while stand.bench.heard(0.0) is not None:
        pass
    with client.lease("fault_campaign"):
        run = client.compensate({**ORDER, "options": {"steps_deg": STEPS_DEG}})["run"]
        time.sleep(delay_s)
        active = client.state()["run"] == run
        at_s = stand.bench.harm(place, how)
        state = stand.until_over()
    stopped_s = stand.stopped_s(at_s)
    ended = state["last"]
    assert ended is not None, "a run has ended"
    last = ended["result"]
    failed = last["status"] == "fault"
    name = (last["fault_name"] or "recorder") if failed else ""
    text = ended["text"] if failed else ""
    try:
        file = RunFile(run)
        whole = file.complete and len(file.table("ticks")) > 0
    except NeedleRigError as error:
        whole, text = False, str(error)
    if how != "reset":
        stand.bench.harm(place, "restore")
    kept_from = not_brought_back(stand)
    if kept_from is not None:
        said = (stand.folder / "log").read_text().splitlines()[-4:]
        text = f"not brought back: {kept_from}; the log ends: {' | '.join(said)}"
    Path(run).unlink(missing_ok=True)
    stopped_ms = (stopped_s - at_s) * 1e3 if failed and active and stopped_s is not None else None
    return Trial(kind, stopped_ms, name, whole, kept_from is None, text)


def not_brought_back(stand: Stand) -> str | None:
    """Clear, find a lost zero, see the base move 1° and back. What kept it from that, or None."""
    client, why = stand.client, ""
    deadline_s = time.monotonic() + 15.0
    while time.monotonic() < deadline_s:
        time.sleep(0.3)
        try:
            with client.lease("fault_campaign"):
                state = client.state()
                if state["fault_name"] == "reference_lost":
                    client.command("home", {"by": "hall"})
                elif state["fault_name"] is not None:
                    client.command("clear")
                else:
                    client.command("jog", {"by_deg": 1.0})
                    state = stand.until_over()
                    if state["phase"] == "done":
                        client.command("home", {"by": "angle"})
                        state = stand.until_over()
                        if state["phase"] == "done":
                            return None
                    # a fault that ends by itself (a link, a late computer) leaves the rig free and not there
                    why = told(state)
        except NeedleRigError as error:
            why = str(error)
    return why


def told(state: State) -> str:
    """Where the rig stands, in one line."""
    return json.dumps({name: state[name] for name in ("phase", "fault", "moving", "lease", "warnings")})


def plan(given: Namespace) -> list[Row]:
    return [{"instant": given.first_seed + number} for number in range(given.size)]


def ask(task: Row, given: Namespace) -> Row:
    """Each fault once in random order, on one stand, or the next where one was not brought back."""
    chance = random.Random(task["instant"])
    left = [kind for kind in KINDS if given.fault in kind]
    chance.shuffle(left)
    done: list[Trial] = []
    while left:
        with tempfile.TemporaryDirectory() as name:
            stand = Stand(Path(name), task["instant"])
            try:
                back = True
                while left and back:
                    done.append(trial(stand, left.pop(), chance.uniform(0.0, LATEST_S)))
                    back = done[-1].back
            finally:
                stand.close()
    return {"trials": [asdict(one) for one in done]}


def trials_of(rows: list[Row]) -> list[Trial]:
    return [Trial(**one) for row in answered(rows) for one in row["trials"]]


def table(rows: list[Row], _: Namespace) -> str:
    """The figures as Markdown."""
    trials = trials_of(rows)
    heads = ["fault", "trials", "stopped ms, median", "at most", "bound", "file whole", "brought back"]
    lines = []
    for kind, bound_ms in KINDS.items():
        these = [one for one in trials if one.kind == kind]
        if not these:
            continue
        times = [one.stopped_ms for one in these if one.stopped_ms is not None]
        middle, most = (f"{statistics.median(times):.0f}", f"{max(times):.0f}") if times else ("", "")
        named = ", ".join(
            f"{name or 'run had ended'} {n}" for name, n in Counter(t.name for t in these).most_common()
        )
        good = (sum(t.whole for t in these), sum(t.back for t in these))
        lines.append((kind, len(these), middle, most, f"{bound_ms:g}", *good, named))
    about = (
        f"{len(trials)} faults, real time, drivers and ports, the firmware's nodes; age"
        f" limits {AGE_LIMIT_MS:g} ms. *Stopped*: from the fault until the drive had left its running state, "
        "of those that met a run.\n"
    )
    notes = (f"- {one.kind}: {one.note}" for one in wrong(trials)[:20])
    return "\n".join([about, markdown([*heads, "named"], lines), "", *notes, ""])


def wrong(trials: list[Trial]) -> list[Trial]:
    """Trials that broke a bound."""
    return [
        one for one in trials if not (one.whole and one.back and (one.stopped_ms or 0.0) <= KINDS[one.kind])
    ]


def failed(rows: list[Row]) -> bool:
    return bool(wrong(trials_of(rows)))


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--fault", default="", help="faults whose name holds this")


CAMPAIGN = Campaign(__doc__, plan, ask, table, 40, "instants of every fault (40)", options, failed, jobs=1)
