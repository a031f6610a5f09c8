"""The service is taken away."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.linux.conftest import PROGRAM, RIG_FILE, RUNS, Rig, shell

pytestmark = pytest.mark.linux


def test_it_is_taken_away_and_leaves_the_runs(rig: Rig) -> None:
    runs = sorted(path.name for path in RUNS.glob("*.h5"))
    assert runs
    told = shell(f"{PROGRAM} install-service --remove", timeout_s=120).stdout
    assert f"The runs stay in {RUNS}" in told
    assert "Rig file, calibration and models stay in /etc/needle-rig" in told
    assert {(path.owner(), path.stat().st_mode & 0o444) for path in RUNS.glob("*.h5")} == {("root", 0o444)}
    assert not Path("/var/cache/needle-rig").exists()
    assert not Path("/usr/local/bin/needle-rig").is_symlink()
    assert shell("systemctl cat needle-rig", check=False).returncode != 0
    assert shell("getent passwd needle-rig", check=False).returncode == 2
    assert not RIG_FILE.exists()
    assert sorted(path.name for path in RUNS.glob("*.h5")) == runs
