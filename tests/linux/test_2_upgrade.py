"""Another version beside the present one: taken back where it fails, waiting for a run, and left again."""

from __future__ import annotations

import json
import os
import subprocess
import zipfile
from pathlib import Path

import pytest

from needle_rig.version import VERSION
from tests.linux.conftest import (
    PROGRAM,
    RIG_FILE,
    Rig,
    begun,
    journal,
    needle_rig,
    outcome,
    shell,
    started_run,
    status,
)

pytestmark = pytest.mark.linux

NEW = "99.1"
ENVIRONMENT = "PIP_NO_INDEX=1 PIP_FIND_LINKS=/share/wheels"
DAEMON = "needle_rig/cli/daemon.py"
BROKEN = "raise SystemExit(70)\n"


def wheel_of(version: str, **changed: str) -> Path:
    """This needle-rig as a wheel of another version, with `changed` texts in front of files."""
    (source,) = Path("/share").glob("needle_rig-*.whl")
    target = Path(f"/root/needle_rig-{version}-py3-none-any.whl")
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            text = old.read(name)
            if name == "needle_rig/version.py" or name.endswith("/METADATA"):
                text = text.replace(VERSION.encode(), version.encode(), 1)
            if name.endswith("/RECORD"):
                text = text.replace(f"-{VERSION}.".encode(), f"-{version}.".encode())
            new.writestr(name.replace(f"-{VERSION}.", f"-{version}."), changed.get(name, "").encode() + text)
    return target


def test_a_version_that_does_not_start_is_taken_back(rig: Rig) -> None:
    wheel = wheel_of(NEW, **{DAEMON: BROKEN})
    before = RIG_FILE.read_text()
    done = shell(f"{ENVIRONMENT} {PROGRAM} install-service --upgrade {wheel}", check=False, timeout_s=280)
    assert done.returncode == 3, done.stdout + done.stderr
    assert f"{NEW} was taken back" in done.stderr
    assert status()["version"] == VERSION
    assert RIG_FILE.read_text() == before


def test_a_version_that_starts_waits_for_a_run_and_can_be_left_again(rig: Rig) -> None:
    if status()["version"] == NEW:  # a trial before came as far as that
        shell("/usr/local/bin/needle-rig install-service --rollback", timeout_s=280)
    # the one of the test before, mended
    (daemon,) = Path(f"/opt/needle-rig/{NEW}").glob(f"lib/python3*/site-packages/{DAEMON}")
    daemon.write_text(daemon.read_text().removeprefix(BROKEN))
    process = started_run("--settle", "600")
    begun(process, "rotate")
    upgrade = subprocess.Popen(
        [PROGRAM, "install-service", "--upgrade", NEW],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert upgrade.stdout is not None
    told: list[str] = []
    while not told or "this run goes on" not in told[-1]:
        told.append(upgrade.stdout.readline())
        assert told[-1], f"the upgrade does not wait: {told}; the run: {process.poll()}; {journal()}"
    assert process.poll() is None
    assert status()["version"] == VERSION
    assert needle_rig("stop").returncode == 0
    process.communicate()
    upgrade.communicate(timeout=280)
    assert upgrade.returncode == 0
    assert status()["version"] == NEW
    assert shell("/usr/local/bin/needle-rig --version").stdout.split()[-1] == NEW
    assert f"the daemon runs needle-rig {NEW}, and this is {VERSION}" in needle_rig("status").stdout

    shell("/usr/local/bin/needle-rig install-service --rollback", timeout_s=280)
    assert status()["version"] == VERSION
    assert shell("/usr/local/bin/needle-rig --version").stdout.split()[-1] == VERSION
    result = outcome()
    assert result["code"] == 0, result
    listed = json.loads(needle_rig("runs", "--json").stdout)
    assert listed[-1]["complete"] is True
