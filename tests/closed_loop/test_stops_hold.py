"""A sample of the stop campaign; the whole of it is python -m campaigns stops."""

import re
import subprocess
import sys

import pytest

from campaigns import ROOT


def campaign(stops: int) -> dict[str, int]:
    done = subprocess.run(
        [sys.executable, "-m", "campaigns", "stops", "--stops", str(stops)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=1200,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "did not hold: 0" in done.stdout
    return {text: int(count) for count, text in re.findall(r"^ *(\d+)  (.*)$", done.stdout, re.MULTILINE)}


@pytest.mark.whole
def test_stops_at_random_instants_hold() -> None:
    counts = campaign(40)
    # the window of a start and the motion were both hit, and something was moving in some of them
    assert sum(count for text, count in counts.items() if text.startswith("start ")) == 20
    assert counts["stop in a motion: run aborted"] >= 5
    assert counts["start begun before the stop: start refused"] >= 5


@pytest.mark.slow
def test_two_thousand_stops_hold() -> None:
    assert sum(campaign(2000).values()) == 2000
