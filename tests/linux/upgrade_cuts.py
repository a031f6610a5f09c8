"""One boot of scripts/upgrade_cuts: what came of the last cut, then another change of version and its cut."""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

from needle_rig.version import VERSION
from tests.linux.conftest import (
    PORTS,
    PROGRAM,
    RIG_FILE,
    RUNS,
    START_S,
    Rig,
    active,
    at_rest,
    outcome,
    shell,
    status,
    until,
)
from tests.linux.test_2_upgrade import ENVIRONMENT, NEW, wheel_of

RECORD = Path("/share/cuts.jsonl")
"""On the host: a cut takes nothing of it."""
FOLDER = Path("/opt/needle-rig")
LINK = "/usr/local/bin/needle-rig"
UPGRADE_S = 600.0
INSTALLS = 4
"""One cut in so many may fall while the version is installed, the others when it is there."""


def main(cuts: int, seed: int) -> int:
    """The exit code, when all cuts are made; 1 where one of them lost something."""
    told = [json.loads(line) for line in RECORD.read_text().splitlines()] if RECORD.exists() else []
    if not told:
        told = [prepared()]
    elif "after_s" in told[-1]:
        told.append(say(**judged(told[0], told[-1])))
    made = sum("after_s" in each for each in told)
    if made < cuts:
        cut(told[0], made, cuts, random.Random(f"{seed} {made}"))
    return concluded(told)


def say(**found: Any) -> dict[str, Any]:
    with RECORD.open("a") as file:
        file.write(json.dumps(found) + "\n")
    return found


def change(command: str) -> float:
    """Another version, or the one before; how long that took, in s."""
    begun_s = time.monotonic()
    shell(f"{ENVIRONMENT} {LINK} install-service {command}", timeout_s=UPGRADE_S)
    return time.monotonic() - begun_s


def prepared() -> dict[str, Any]:
    """A service with a run, and how long a change takes that is not cut."""
    shell("useradd --create-home tech")
    shell(f"{PROGRAM} install-service --name guest --can vcan0 --hall {PORTS}/hall --member tech --no-start")
    text = RIG_FILE.read_text().replace("tick_hz: 200", "tick_hz: 100")
    RIG_FILE.write_text(text.replace("_age_limit_ms: 50", "_age_limit_ms: 500"))
    shell("systemctl start needle-rig", timeout_s=START_S)
    turned()
    wheel = wheel_of(NEW)
    install_s = change(f"--upgrade {wheel}")
    switch_s = change("--rollback")
    os.sync()
    return say(install_s=install_s, switch_s=switch_s, kept=kept(), failing=failing())


def turned() -> None:
    """The needle is turned once, by a rig that is switched on for it."""
    rig = Rig()
    rig.switch_on()
    try:
        until(
            lambda: active() and status().get("sensors") is not None and at_rest(),
            "the rig is found",
            START_S,
        )
        until(rig.cleared, "no fault stands")
        rig.refer()
        told = outcome()
        assert told["code"] == 0, told
    finally:
        rig.switch_off()


def kept() -> dict[str, str]:
    """What no change of the version may touch."""
    files = [*RUNS.glob("*.h5"), *(path for path in RIG_FILE.parent.rglob("*") if path.is_file())]
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(files)}


def failing() -> list[str]:
    said = shell(f"{LINK} check --json", check=False).stdout
    return sorted(each["name"] for each in json.loads(said)["findings"] if each["verdict"] == "fail")


def judged(base: dict[str, Any], last: dict[str, Any]) -> dict[str, Any]:
    """How the rig came up after the last cut, and what is lost."""
    until(lambda: active() and "version" in status(), "the service runs", START_S)
    ready_s = float(Path("/proc/uptime").read_text().split()[0])
    now, lost = kept(), []
    lost += [path for path, digest in base["kept"].items() if now.get(path) != digest]
    lost += [f"check: {name}" for name in failing() if name not in base["failing"]]
    for path in (FOLDER / "backups").glob("*.zip"):
        with zipfile.ZipFile(path) as file:
            lost += [str(path)] if file.testzip() else []
    version, command = status()["version"], shell(f"{LINK} --version").stdout.split()[-1]
    lost += [f"version {version}"] if version not in (VERSION, NEW) else []
    return {"of": last["cut"], "version": version, "command": command, "ready_s": ready_s, "lost": lost}


def cut(base: dict[str, Any], number: int, cuts: int, chance: random.Random) -> None:
    """Begin a change, and cut the power in it."""
    installs = number < cuts // INSTALLS
    if installs:
        if status()["version"] == NEW:
            change("--rollback")
        shutil.rmtree(FOLDER / NEW, ignore_errors=True)
        command, span_s = f"--upgrade /root/needle_rig-{NEW}-py3-none-any.whl", base["install_s"]
    else:
        if not (FOLDER / NEW / ".whole").exists():
            change(f"--upgrade /root/needle_rig-{NEW}-py3-none-any.whl")
        command = "--rollback" if status()["version"] == NEW else f"--upgrade {NEW}"
        span_s = base["switch_s"]
    os.sync()
    after_s = chance.uniform(0.0, span_s)
    before = status()["version"]
    process = subprocess.Popen(f"{ENVIRONMENT} exec {LINK} install-service {command}", shell=True)
    time.sleep(after_s)
    say(cut=number + 1, installs=installs, before=before, after_s=after_s, ended=process.poll())
    Path("/proc/sys/kernel/sysrq").write_text("1")
    Path("/proc/sysrq-trigger").write_text("b")  # at once: nothing is written to the disk any more
    time.sleep(30)
    raise AssertionError("the machine still runs")


def concluded(told: list[dict[str, Any]]) -> int:
    """All cuts in a table; the needle is turned once more."""
    turned()
    found = {each["of"]: each for each in told if "of" in each}
    base = told[0]
    lines = [
        f"An upgrade that installs takes {base['install_s']:.0f} s, a way back {base['switch_s']:.0f} s.",
        "",
        "| cut | it installs | from | cut after | came up with | command | up after boot | lost |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for each in told:
        if "after_s" not in each:
            continue
        of = found[each["cut"]]
        after = f"{each['after_s']:.1f} s" + (
            "" if each["ended"] is None else f" (it ended: {each['ended']})"
        )
        cells = (each["cut"], "yes" if each["installs"] else "no", each["before"], after)
        came = (of["version"], of["command"], f"{of['ready_s']:.0f} s", ", ".join(of["lost"]) or "nothing")
        lines.append(f"| {' | '.join(map(str, (*cells, *came)))} |")
    lines += ["", "After the last one the needle was turned, exit code 0."]
    sys.stdout.write("\n".join(lines) + "\n")
    return int(any(each["lost"] for each in found.values()))


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2])))
