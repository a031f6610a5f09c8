"""The service is taken away."""

from __future__ import annotations

import pytest

from tests.linux.conftest import PROGRAM, RIG_FILE, RUNS, Rig, shell

pytestmark = pytest.mark.linux


def test_it_is_taken_away_and_leaves_the_runs(rig: Rig) -> None:
    runs = sorted(path.name for path in RUNS.glob("*.h5"))
    assert runs
    shell(f"{PROGRAM} install-service --remove", timeout_s=120)
    assert shell("systemctl cat needle-rig", check=False).returncode != 0
    assert shell("getent passwd needle-rig", check=False).returncode == 2
    assert not RIG_FILE.exists()
    assert sorted(path.name for path in RUNS.glob("*.h5")) == runs
