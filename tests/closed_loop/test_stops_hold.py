"""A sample of the stop campaign; the whole of it is python -m campaigns stops."""

import json
import subprocess
import sys

import pytest

from campaigns import ROOT


def ends(stops: int) -> dict[str, int]:
    words = ["campaigns", "stops", "--only", json.dumps({"seed": 1, "stops": stops})]
    line = [sys.executable, "-m", *words]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stdout + done.stderr
    row = json.loads(done.stdout)
    assert not row["broken"]
    return dict(row["ends"])


@pytest.mark.whole
def test_stops_at_random_instants_hold() -> None:
    counts = ends(40)
    # the window of a start and the motion were both hit, and something was moving in some of them
    assert sum(count for text, count in counts.items() if text.startswith("start ")) == 20
    assert counts["stop in a motion: run aborted"] >= 5
    assert counts["start begun before the stop: start refused"] >= 5


@pytest.mark.slow
def test_two_thousand_stops_hold() -> None:
    assert sum(ends(2000).values()) == 2000
